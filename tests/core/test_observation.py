# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Marginals of what a policy reads."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.observation import LOWEST_STD, Observation, observed_marginals, widened


class Polar:
    """Radius and angle of the first two of four numbers."""

    names = ("radius", "angle")
    space = StateSpace(4)

    def __call__(self, states):
        x, y = states[..., 0], states[..., 1]
        return np.stack([np.hypot(x, y), np.arctan2(y, x)], -1)

    def pull_back(self, jacobians, states):
        x, y = states[..., 0], states[..., 1]
        radius, nothing = np.hypot(x, y), np.zeros_like(x)
        rows = [[x / radius, y / radius], [-y / radius**2, x / radius**2]]
        h_x = np.stack([np.stack([*row, nothing, nothing], -1) for row in rows], -2)
        return jacobians @ h_x


def test_marginals_of_coordinates_are_parts_of_the_states(random_distribution, coordinates):
    q, chosen = random_distribution(), [1, 3]
    means, covariances = observed_marginals(q, coordinates(*chosen))
    assert_array_equal(means, q.mean.states[:-1, chosen])
    assert_allclose(covariances, q.state_covariances[:-1][:, chosen][:, :, chosen], rtol=1e-14)


def test_marginals_of_a_curved_reading_are_those_of_samples_close_by(random_distribution, rng):
    q = random_distribution(horizon=3)
    q.mean.states[:, :2] += 5.0
    q.state_covariances[:] *= 1e-6
    means, covariances = observed_marginals(q, Observation(Polar()))
    for t in range(3):
        states = rng.multivariate_normal(q.mean.states[t], q.state_covariances[t], 100_000)
        read = Polar()(states)
        std = np.sqrt(np.diagonal(covariances[t]))
        assert_allclose((read.mean(axis=0) - means[t]) / std, 0.0, atol=0.02)
        found = np.cov(read.T) / np.outer(std, std)
        assert_allclose(found, covariances[t] / np.outer(std, std), atol=0.02)


def test_a_covariance_that_is_singular_can_be_inverted_once_it_is_widened():
    flat = np.diag([1.0, 0.0])
    assert_allclose(np.linalg.inv(widened(flat))[1, 1], LOWEST_STD**-2)
