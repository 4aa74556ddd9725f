# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What q would do in states that the policy has visited."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from vgps_ros.core import visited_states
from vgps_ros.core.observation import widen_covariances
from vgps_ros.core.visited_states import likeliest_steps, visited_targets

HORIZON = 12


@pytest.fixture
def q(random_distribution):
    """q whose steps lie far apart, so that a state near one of them is near no other."""
    q = random_distribution(horizon=HORIZON)
    q.mean.states[:] += 100.0 * np.arange(HORIZON + 1)[:, None]
    return q


def test_the_step_is_the_one_of_the_highest_density(random_distribution, coordinates, rng):
    q, o = random_distribution(horizon=HORIZON), rng.standard_normal((50, 3))
    step, distance = likeliest_steps(q, coordinates(0, 2, 3), o)
    covariances = widen_covariances(q.state_covariances[:-1][:, [0, 2, 3]][:, :, [0, 2, 3]])
    means = q.mean.states[:-1, [0, 2, 3]]
    densities = [
        multivariate_normal(m, c).logpdf(o) for m, c in zip(means, covariances, strict=True)
    ]
    assert_array_equal(step, np.argmax(densities, axis=0))
    difference = o - means[step]
    squares = np.einsum("ni,nij,nj->n", difference, np.linalg.inv(covariances[step]), difference)
    assert_allclose(distance, np.sqrt(squares / 3), rtol=1e-9)


def test_a_state_gets_what_q_does_at_the_step_where_it_passes(q, coordinates, rng):
    late, near = 4, 0.1 * rng.standard_normal((3, HORIZON - 4, 4))
    visited = q.mean.states[late:-1] + near  # a robot that began its motion some steps later
    found = visited_targets(q, coordinates(0, 1, 2, 3), visited, limit=2.0)
    u = q.mean.controls[late:] + np.einsum("tux,ntx->ntu", q.gains[late:], near)
    assert_allclose(found.inputs, visited.reshape(-1, 4))
    assert_allclose(found.means, u.reshape(-1, 2), rtol=1e-9)
    variances = np.diagonal(q.control_covariances[late:], axis1=1, axis2=2)
    assert_array_equal(found.variances, np.tile(variances, (3, 1)))


def test_what_the_policy_does_not_read_changes_no_target(q, coordinates, rng):
    visited = q.mean.states[None, :-1] + [0.0, 1000.0, 0.0, 0.0]
    found = visited_targets(q, coordinates(0, 2, 3), visited, limit=2.0)
    assert_allclose(found.means, q.mean.controls, atol=1e-9)


def test_a_rollout_counts_until_it_leaves_q(q, coordinates):
    visited = np.tile(q.mean.states[:-1], (3, 1, 1))
    visited[0, 5] += 50.0  # it comes back, which helps it no more
    visited[1, 7:] = np.nan  # it diverges
    visited[2, 0] += 50.0
    found = visited_targets(q, coordinates(0, 1, 2, 3), visited, limit=2.0)
    assert_array_equal(found.inputs, np.concatenate([visited[0, :5], visited[1, :7]]))
    assert len(found.means) == len(found.variances) == 12


def test_marginals_that_are_flat_are_as_wide_as_the_least_deviation(q, coordinates):
    q.state_covariances[:] = 0.0
    visited = q.mean.states[None, :-1] + [0.01, 0.0, 0.0, 0.0]
    _, distance = likeliest_steps(q, coordinates(0, 1, 2, 3), visited[0])
    assert_allclose(distance, np.sqrt(1 / 4), rtol=1e-6)


def test_of_a_long_motion_the_steps_around_the_best_of_some_are_tried(
    random_distribution, coordinates, rng, monkeypatch
):
    q = random_distribution(horizon=HORIZON)
    q.mean.states[:] = 3.0 * np.arange(HORIZON + 1)[:, None]
    q.state_covariances[:] = np.eye(4)
    o = q.mean.states[:-1].repeat(5, axis=0) + rng.standard_normal((5 * HORIZON, 4))
    o[7] = np.nan  # a rollout that has diverged
    expected = likeliest_steps(q, coordinates(0, 1, 2, 3), o)
    monkeypatch.setattr(visited_states, "MOST_CANDIDATES", 4)
    step, distance = likeliest_steps(q, coordinates(0, 1, 2, 3), o)
    sound = np.arange(len(o)) != 7
    assert_array_equal(step[sound], expected[0][sound])
    assert_allclose(distance, expected[1], rtol=1e-9)


def test_all_steps_up_to_the_next_of_some_are_tried_by_their_densities(
    random_distribution, coordinates, rng, monkeypatch
):
    q = random_distribution(horizon=HORIZON)
    q.mean.states[:] = 0.5 * np.arange(HORIZON + 1)[:, None]
    widths = np.exp(rng.standard_normal(HORIZON + 1))
    q.state_covariances[:] = widths[:, None, None] * np.eye(4)
    o = rng.uniform(0.0, 6.0, (300, 4))
    means, covariances = q.mean.states[:-1], widen_covariances(q.state_covariances[:-1])
    densities = np.array(
        [multivariate_normal(*m).logpdf(o) for m in zip(means, covariances, strict=True)]
    )
    best = 3 * densities[::3].argmax(axis=0)  # of steps 0, 3, 6, 9
    is_near = np.abs(np.arange(HORIZON)[:, None] - best) < 3
    expected = np.where(is_near, densities, -np.inf).argmax(axis=0)
    monkeypatch.setattr(visited_states, "MOST_CANDIDATES", 4)
    step, _ = likeliest_steps(q, coordinates(0, 1, 2, 3), o)
    assert set(expected - best) == {-2, -1, 0, 1, 2}
    assert_array_equal(step, expected)
