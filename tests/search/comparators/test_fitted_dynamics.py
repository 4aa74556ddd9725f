# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Dynamics fitted to rollouts, beside the dynamics that made the rollouts."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vgps_ros.core.dynamics import StateSpace
from vgps_ros.search.comparators.fitted_dynamics import (
    Mixture,
    fitted_dynamics,
    mean_trajectory,
    transitions,
)

T, N_X, N_U = 6, 3, 2
SPACE = StateSpace(N_X)
NOISE = 0.5


@pytest.fixture
def system(rng):
    """Some linear dynamics that change with time."""
    f_x = np.eye(N_X) + 0.3 * rng.standard_normal((T, N_X, N_X))
    return f_x, rng.standard_normal((T, N_X, N_U))


def rollouts(system, count, rng, noise=NOISE):
    f_x, f_u = system
    states = [np.array([1.0, -2.0, 0.5]) + rng.standard_normal((count, N_X))]
    controls = rng.standard_normal((T, count, N_U))
    for a, b, u in zip(f_x, f_u, controls, strict=True):
        drawn = noise * rng.standard_normal((count, N_X))
        states.append(states[-1] @ a.T + u @ b.T + drawn)
    return np.stack(states, axis=1), controls.swapaxes(0, 1)


def fit(states, controls, rng, most=4):
    origin = np.zeros(N_X)
    points = transitions(SPACE, origin, states, controls).reshape(-1, 2 * N_X + N_U)
    return fitted_dynamics(SPACE, states, controls, Mixture.fitted(points, most, rng), origin)


def error(system, count, rng):
    linear, _ = fit(*rollouts(system, count, rng), rng)
    squares = (linear.f_x - system[0]) ** 2, (linear.f_u - system[1]) ** 2
    return np.sqrt(np.mean(np.concatenate([s.ravel() for s in squares])))


def test_the_error_falls_with_the_root_of_the_number_of_rollouts(system, rng):
    few, many = (np.median([error(system, n, rng) for _ in range(7)]) for n in (100, 1600))
    # Sixteen times as many rollouts leave about a quarter of the error.
    assert 2.5 < few / many < 6.5


def test_the_noise_of_the_dynamics_is_found(system, rng):
    _, noise = fit(*rollouts(system, 4000, rng), rng)
    assert_allclose(noise, NOISE, rtol=0.1)


def test_few_rollouts_learn_what_all_steps_share_from_the_prior(rng):
    a, b = np.eye(N_X) + 0.3 * rng.standard_normal((N_X, N_X)), rng.standard_normal((N_X, N_U))
    still = np.tile(a, (T, 1, 1)), np.tile(b, (T, 1, 1))
    before, now = rollouts(still, 50, rng, 0.05), rollouts(still, 4, rng, 0.05)  # n_x + n_u are 5
    origin, n = np.zeros(N_X), 2 * N_X + N_U
    own, all_of_them = (
        np.concatenate([transitions(SPACE, origin, *each).reshape(-1, n) for each in some])
        for some in ([now], [before, now])
    )
    found = []
    for points in (own[:1], all_of_them):
        prior = Mixture.fitted(points, 1, rng)
        linear, _ = fitted_dynamics(SPACE, *now, prior, origin)
        found.append(np.abs(linear.f_x - a).max())
    assert found[1] < 0.1 < found[0]


def test_a_mixture_finds_the_clusters_of_its_points(rng):
    centres = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    points = np.concatenate([c + rng.standard_normal((200, 2)) for c in centres])
    mixture = Mixture.fitted(points, 3, rng)
    for centre in centres:
        nearest = np.argmin(np.linalg.norm(mixture.means - centre, axis=1))
        assert_allclose(mixture.means[nearest], centre, atol=0.3)
        assert_allclose(mixture.covariances[nearest], np.eye(2), atol=0.4)
        assert mixture.shares(centre)[nearest] > 0.99


def test_a_body_that_turns_is_fitted_in_its_own_frames(rng):
    """A quaternion turned by the control: q' = q exp(u), from starts far from x_0."""
    space = StateSpace(4, (0,))
    count, origin = 400, np.array([1.0, 0.0, 0.0, 0.0])
    away = np.array([0.9, -0.6, 0.4])
    first = space.add(
        np.tile(space.add(origin, away), (count, 1)), 0.05 * rng.standard_normal((count, 3))
    )
    controls = np.array([0.2, 0.1, -0.3]) + 0.05 * rng.standard_normal((count, 2, 3))
    states = [first]
    for t in range(2):
        states.append(space.add(states[-1], controls[:, t]))
    states = np.stack(states, axis=1)
    points = transitions(space, origin, states, controls).reshape(-1, 9)
    linear, _ = fitted_dynamics(space, states, controls, Mixture.fitted(points, 1, rng), origin)
    mean = mean_trajectory(space, states, controls)
    for t in range(2):
        expected_x, expected_u = np.empty((3, 3)), np.empty((3, 3))
        for i, d in enumerate(1e-5 * np.eye(3)):
            x, u = mean.states[t], mean.controls[t]
            following = space.add(x, u)
            expected_x[:, i] = space.subtract(space.add(space.add(x, d), u), following) / 1e-5
            expected_u[:, i] = space.subtract(space.add(x, u + d), following) / 1e-5
        assert_allclose(linear.f_x[t], expected_x, atol=0.02)
        assert_allclose(linear.f_u[t], expected_u, atol=0.02)
