# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""DAGGER's dataset: the oracle's actions, and the weights by the DDP marginals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from vgps_ros.core.records import LinearDynamics, Trajectory, TrajectoryDistribution
from vgps_ros.search.comparators.dagger import marginal_log_weights, oracle_targets

HORIZON, OBSERVED = 3, (1, 2)


@pytest.fixture
def observation(coordinates):
    return coordinates(*OBSERVED, n_x=3)


@pytest.fixture
def q(rng):
    roots = rng.standard_normal((HORIZON + 1, 3, 4))
    return TrajectoryDistribution(
        mean=Trajectory(rng.standard_normal((HORIZON + 1, 3)), rng.standard_normal((HORIZON, 2))),
        gains=rng.standard_normal((HORIZON, 2, 3)),
        control_covariances=np.tile(np.diag([2.0, 3.0]), (HORIZON, 1, 1)),
        linear_dynamics=LinearDynamics(np.zeros((HORIZON, 3, 3)), np.zeros((HORIZON, 3, 2))),
        state_covariances=roots @ np.swapaxes(roots, 1, 2),
        context=np.empty((HORIZON, 0)),
    )


def test_targets_are_what_the_local_policy_does_at_each_state(q, observation, rng):
    visited = rng.standard_normal((4, HORIZON, 3))
    visited[2, 1:] = np.nan  # that rollout diverged
    targets, weights = oracle_targets([q], [visited], observation, weighted=False)
    assert weights is None
    assert len(targets.inputs) == 4 * HORIZON - 2
    row = 0
    for n, t in np.ndindex(4, HORIZON):
        if n == 2 and t > 0:
            continue
        x = visited[n, t]
        assert_allclose(targets.inputs[row], x[list(OBSERVED)])
        expected = q.mean.controls[t] + q.gains[t] @ (x - q.mean.states[t])
        assert_allclose(targets.means[row], expected)
        assert_array_equal(targets.variances[row], 0.0)
        row += 1


def test_weights_are_densities_relative_to_the_most_probable_state(q, observation, rng):
    states = q.mean.states[:-1] + 0.3 * rng.standard_normal((5, HORIZON, 3))
    found = np.exp(marginal_log_weights(q, observation(states), observation))
    for n, t in np.ndindex(5, HORIZON):
        chosen = np.ix_(OBSERVED, OBSERVED)
        mean = q.mean.states[t][list(OBSERVED)]
        density = multivariate_normal(mean, q.state_covariances[t][chosen] + 1e-4 * np.eye(2)).pdf
        ratio = density(states[n, t, list(OBSERVED)]) / density(mean)
        assert_allclose(found[n, t], np.sqrt(ratio))  # per dimension, of which there are two


def test_weights_ignore_what_the_policy_does_not_read(q, observation, rng):
    states = rng.standard_normal((2, HORIZON, 3))
    moved = states + np.array([100.0, 0.0, 0.0])
    (_, found), (_, expected) = (
        oracle_targets([q], [visited], observation, weighted=True) for visited in (moved, states)
    )
    assert_allclose(found, expected)


def test_weights_sum_to_one_and_far_states_weigh_nothing(q, observation):
    states = np.stack([q.mean.states[:-1], q.mean.states[:-1] + 1e3])
    _, weights = oracle_targets([q], [states], observation, weighted=True)
    assert_allclose(weights, [1 / HORIZON] * HORIZON + [0.0] * HORIZON, atol=1e-12)
