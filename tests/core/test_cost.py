import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.records import Trajectory

WEIGHT = 0.3
TARGETS = np.array([1.0, -2.0])


def product_and_sine(states):
    """Two features of three coordinates: x_0 x_1 and sin x_2."""
    x, y, z = np.moveaxis(states, -1, 0)
    zero = np.zeros_like(x)
    jacobian = np.stack([np.stack([y, x, zero], -1), np.stack([zero, zero, np.cos(z)], -1)], -2)
    return np.stack([x * y, np.sin(z)], -1), jacobian


@pytest.fixture
def cost():
    return FeatureCost(product_and_sine, TARGETS, WEIGHT)


@pytest.fixture
def trajectory(rng):
    return Trajectory(rng.standard_normal((6, 3)), rng.standard_normal((5, 2)))


def test_values_are_the_formula_and_the_last_state_is_free(cost, trajectory):
    expected = [
        WEIGHT * (u[0] ** 2 + u[1] ** 2) + (x[0] * x[1] - 1) ** 2 + (np.sin(x[2]) + 2) ** 2
        for x, u in zip(trajectory.states, trajectory.controls, strict=False)
    ]
    assert_allclose(cost.values(trajectory), expected, rtol=1e-14)
    assert_array_equal(cost.expand(trajectory).c, cost.values(trajectory))


def test_cost_of_many_rollouts_is_that_of_each(cost, rng):
    states, controls = rng.standard_normal((4, 6, 3)), rng.standard_normal((4, 5, 2))
    together = cost(states[:, :-1], controls)
    for i in range(4):
        assert_allclose(together[i], cost.values(Trajectory(states[i], controls[i])), rtol=1e-14)


def test_gradients_agree_with_finite_differences(cost, trajectory, finite_differences):
    expansion = cost.expand(trajectory)
    for t, u in enumerate(trajectory.controls):
        x = trajectory.states[t]
        c_x = finite_differences(lambda x, u=u: cost(x, u), x)
        c_u = finite_differences(lambda u, x=x: cost(x, u), u)
        assert_allclose(expansion.c_x[t], c_x, atol=1e-8)
        assert_allclose(expansion.c_u[t], c_u, atol=1e-8)


def test_hessian_is_gauss_newtons(cost, trajectory):
    expansion = cost.expand(trajectory)
    for t, state in enumerate(trajectory.states[:-1]):
        jacobian = product_and_sine(state)[1]
        assert_allclose(expansion.c_xx[t], 2 * jacobian.T @ jacobian, rtol=1e-13)
    assert_array_equal(expansion.c_uu, np.tile(2 * WEIGHT * np.eye(2), (5, 1, 1)))
    assert_array_equal(expansion.c_ux, 0.0)
