# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The weights of cost-weighted search, and what they are used for."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.search.comparators.cost_weighted import cost_weights, weighted_targets
from vgps_ros.search.workspace import Rollouts


def test_weights_are_exponentials_of_the_cost(rng):
    costs = rng.uniform(0, 10, 6)
    expected = np.exp(-0.7 * costs) / np.exp(-0.7 * costs).sum()
    assert_allclose(cost_weights(costs, 0.7), expected)


def test_weights_do_not_change_with_a_shift_of_the_cost(rng):
    costs = rng.uniform(0, 10, 6)
    assert_allclose(cost_weights(costs + 1e6, 0.7), cost_weights(costs, 0.7), rtol=1e-8)


def test_the_best_rollout_is_left_alone_where_the_cost_is_scaled_up():
    assert_array_equal(cost_weights(np.array([3.0, 1.0, 2.0]), 1e4), [0.0, 1.0, 0.0])


def test_each_step_of_a_rollout_has_its_weight(rng, coordinates):
    states, controls = rng.standard_normal((3, 4, 4)), rng.standard_normal((3, 4, 1))
    costs = np.array([[0.1] * 4, [50.0] * 4, [0.2] * 4])
    draws = [Rollouts(states, controls, costs)]
    targets, weights = weighted_targets(draws, [coordinates(1, 3)], alpha=1.0)
    share = 1 / (1 + np.exp(-0.4))
    assert_array_equal(targets.inputs, states[..., [1, 3]].reshape(-1, 2))
    assert_array_equal(targets.means, controls.reshape(-1, 1))
    assert_array_equal(targets.variances, 0.0)
    assert_allclose(weights, np.repeat([share, 0.0, 1 - share], 4) / 4, atol=1e-12)


def test_initial_states_count_alike_however_much_they_cost(rng, coordinates):
    def rollouts(cost):
        return Rollouts(
            rng.standard_normal((2, 3, 4)), rng.standard_normal((2, 3, 1)), np.full((2, 3), cost)
        )

    read = [coordinates(0, 1), coordinates(0, 1)]
    _, weights = weighted_targets([rollouts(1.0), rollouts(100.0)], read, alpha=1.0)
    assert_allclose(weights, np.full(12, 1 / 12))
