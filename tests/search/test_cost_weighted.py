"""The weights of cost-weighted search, and what they are used for."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.search.cost_weighted import cost_weights, weighted_targets
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


def test_each_step_of_a_rollout_has_its_weight(rng):
    states, controls = rng.standard_normal((3, 4, 2)), rng.standard_normal((3, 4, 1))
    costs = np.array([[0.1] * 4, [50.0] * 4, [0.2] * 4])
    targets, weights = weighted_targets([Rollouts(states, controls, costs)], alpha=1.0)
    share = 1 / (1 + np.exp(-0.4))
    assert_array_equal(targets.states, states.reshape(-1, 2))
    assert_array_equal(targets.means, controls.reshape(-1, 1))
    assert_array_equal(targets.variances, 0.0)
    assert_allclose(weights, np.repeat([share, 0.0, 1 - share], 4) / 4, atol=1e-12)


def test_initial_states_count_alike_however_much_they_cost(rng):
    def rollouts(cost):
        return Rollouts(
            rng.standard_normal((2, 3, 2)), rng.standard_normal((2, 3, 1)), np.full((2, 3), cost)
        )

    _, weights = weighted_targets([rollouts(1.0), rollouts(100.0)], alpha=1.0)
    assert_allclose(weights, np.full(12, 1 / 12))
