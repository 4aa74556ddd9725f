# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Marginals of what a policy reads."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.observation import LOWEST_STD, Observation, observed_marginals, widen_covariances


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
    assert_allclose(np.linalg.inv(widen_covariances(flat))[1, 1], LOWEST_STD**-2)


def told_of(coordinates, context):
    """Reads x_1 and the last number of a context of two."""
    reading = coordinates(1).readings
    return Observation.of(reading, ["clock"], ["command", "clock"]).within(context)


def test_what_is_told_comes_after_what_is_read(coordinates, rng):
    states, context = rng.standard_normal((5, 4)), rng.standard_normal((5, 2))
    observation = told_of(coordinates, context)
    assert observation.names == ("x1", "clock")
    assert_array_equal(observation(states), np.stack([states[:, 1], context[:, 1]], -1))
    assert_array_equal(observation(states[:3]), observation(states)[:3])
    assert_array_equal(observation.within(context[2])(states[2]), [states[2, 1], context[2, 1]])
    many = observation(np.stack([states, -states]))
    assert_array_equal(many[1], np.stack([-states[:, 1], context[:, 1]], -1))


def test_each_of_several_motions_is_told_its_own(coordinates, rng):
    states, context = rng.standard_normal((3, 5, 4)), rng.standard_normal((3, 5, 2))
    found = told_of(coordinates, context)(states)
    assert_array_equal(found[..., 1], context[..., 1])


def test_nothing_is_differentiated_along_what_is_told(coordinates, rng):
    jacobians, states = rng.standard_normal((5, 2, 2)), rng.standard_normal((5, 4))
    found = told_of(coordinates, np.zeros((5, 2))).pull_back(jacobians, states)
    assert_array_equal(found, jacobians[..., :1] * np.eye(4)[1])


def test_marginals_of_what_is_told_have_no_spread(coordinates, random_distribution, rng):
    q = replace(random_distribution(), context=rng.standard_normal((6, 2)))
    means, covariances = observed_marginals(q, told_of(coordinates, None))
    assert_array_equal(means[:, 1], q.context[:, 1])
    assert_array_equal(covariances[:, 1], 0.0)
    assert_array_equal(covariances[:, 0, 0], q.state_covariances[:-1, 1, 1])
