# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.cost import FeatureCost, Following
from vgps_ros.core.records import Trajectory

HORIZON = 5
CONTROL_WEIGHTS = np.array([0.3, 0.1])
TARGETS, WEIGHTS = np.array([1.0, -2.0, 0.5]), np.array([2.0, 0.7, 1.5])


class Features:
    """Three features of three coordinates and two controls: x_0 x_1, sin x_2, x_2 u_0."""

    def __call__(self, states, controls):
        x, y, z = np.moveaxis(states, -1, 0)
        return np.stack([x * y, np.sin(z), z * controls[..., 0]], -1)

    def linearize(self, states, controls):
        (x, y, z), u = np.moveaxis(states, -1, 0), controls[..., 0]
        by_state, by_control = np.zeros((*x.shape, 3, 3)), np.zeros((*x.shape, 3, 2))
        by_state[..., 0, 0], by_state[..., 0, 1], by_state[..., 1, 2] = y, x, np.cos(z)
        by_state[..., 2, 2], by_control[..., 2, 0] = u, z
        return self(states, controls), by_state, by_control


@pytest.fixture
def cost():
    return FeatureCost(Features(), TARGETS, WEIGHTS, np.zeros(3), CONTROL_WEIGHTS)


@pytest.fixture
def varying(rng):
    """Targets and weights change with time, and two norms are smooth absolute values."""
    return FeatureCost(
        Features(),
        rng.standard_normal((HORIZON, 3)),
        rng.uniform(0.5, 2.0, (HORIZON, 3)),
        np.array([0.0, 0.2, 1.3]),
        CONTROL_WEIGHTS,
    )


@pytest.fixture
def trajectory(rng):
    return Trajectory(rng.standard_normal((HORIZON + 1, 3)), rng.standard_normal((HORIZON, 2)))


def test_values_are_the_formula_and_the_last_state_is_free(cost, trajectory):
    expected = [
        0.3 * u[0] ** 2
        + 0.1 * u[1] ** 2
        + 2.0 * (x[0] * x[1] - 1.0) ** 2
        + 0.7 * (np.sin(x[2]) + 2.0) ** 2
        + 1.5 * (x[2] * u[0] - 0.5) ** 2
        for x, u in zip(trajectory.states, trajectory.controls, strict=False)
    ]
    assert_allclose(cost.values(trajectory), expected, rtol=1e-14)
    assert_array_equal(cost.expand(trajectory).c, cost.values(trajectory))


def test_each_step_has_its_targets_and_weights(varying, trajectory):
    for t, (x, u) in enumerate(zip(trajectory.states, trajectory.controls, strict=False)):
        e = varying.features(x, u) - varying.targets[t]
        norms = [e[0] ** 2, np.hypot(e[1], 0.2) - 0.2, np.hypot(e[2], 1.3) - 1.3]
        expected = varying.weights[t] @ norms + CONTROL_WEIGHTS @ u**2
        assert_allclose(varying.values(trajectory)[t], expected, rtol=1e-13)
        one = varying(x[None], u[None], first=t)
        assert_allclose(one, [expected], rtol=1e-13)
    assert_array_equal(varying.expand(trajectory).c, varying.values(trajectory))


def test_far_from_its_target_a_smooth_absolute_value_grows_linearly():
    cost = FeatureCost(Features(), np.zeros(3), np.ones(3), np.array([0.0, 0.0, 0.1]), np.zeros(2))
    states, controls = np.zeros((3, 3)), np.zeros((3, 2))
    states[:, 2], controls[:, 0] = 1.0, [0.0, 1e3, 2e3]
    zero, near, far = cost(states, controls) - np.sin(1.0) ** 2
    assert zero == pytest.approx(0.0, abs=1e-15)
    assert_allclose([near, far], [1e3 - 0.1, 2e3 - 0.1], rtol=1e-7)


def test_cost_of_many_rollouts_is_that_of_each(varying, rng):
    states = rng.standard_normal((4, HORIZON + 1, 3))
    controls = rng.standard_normal((4, HORIZON, 2))
    together = varying(states[:, :-1], controls)
    for i in range(4):
        each = varying.values(Trajectory(states[i], controls[i]))
        assert_allclose(together[i], each, rtol=1e-14)


def test_at_rest_every_reading_and_control_is_zero(cost, varying):
    assert_allclose(cost.rest(3), np.full(3, WEIGHTS @ TARGETS**2), rtol=1e-14)
    still = np.zeros((HORIZON, 3)), np.zeros((HORIZON, 2))  # every feature of this state is zero
    assert_allclose(varying.rest(HORIZON), varying(*still), rtol=1e-14)
    assert_array_equal(varying.rest(2, first=3), varying.rest(HORIZON)[3:])


@pytest.mark.parametrize("kind", ["cost", "varying"])
def test_gradients_agree_with_finite_differences(kind, request, trajectory, finite_differences):
    cost = request.getfixturevalue(kind)
    expansion = cost.expand(trajectory)
    for t, u in enumerate(trajectory.controls):
        x = trajectory.states[t]
        c_x = finite_differences(lambda x, u=u, t=t: cost(x[None], u[None], t)[0], x)
        c_u = finite_differences(lambda u, x=x, t=t: cost(x[None], u[None], t)[0], u)
        assert_allclose(expansion.c_x[t], c_x, atol=1e-8)
        assert_allclose(expansion.c_u[t], c_u, atol=1e-8)


@pytest.mark.parametrize("kind", ["cost", "varying"])
def test_hessian_is_gauss_newtons(kind, request, trajectory, finite_differences):
    """Jᵀ diag(w ρ'') J, where ρ'' is the second derivative of the norm alone."""
    cost = request.getfixturevalue(kind)
    expansion = cost.expand(trajectory)
    targets, weights = (np.broadcast_to(a, (HORIZON, 3)) for a in (cost.targets, cost.weights))
    readings, by_state, by_control = cost.features.linearize(
        trajectory.states[:-1], trajectory.controls
    )
    s = np.where(cost.smooth > 0, cost.smooth, 1.0)

    def slope(e):
        return np.where(cost.smooth > 0, e / np.sqrt(e**2 + s**2), 2 * e)

    for t in range(HORIZON):
        curvature = np.diagonal(finite_differences(slope, readings[t] - targets[t]))
        j = np.hstack([by_state[t], by_control[t]])
        expected = j.T @ np.diag(weights[t] * curvature) @ j
        expected[3:, 3:] += np.diag(2 * CONTROL_WEIGHTS)
        found = np.block(
            [[expansion.c_xx[t], expansion.c_ux[t].T], [expansion.c_ux[t], expansion.c_uu[t]]]
        )
        assert_allclose(found, expected, atol=1e-8)
        assert np.linalg.eigvalsh(found)[0] > -1e-12


def test_a_norm_that_is_hardly_smooth_has_finite_derivatives_at_its_target(cost):
    sharp = dataclasses.replace(cost, targets=np.zeros(3), smooth=np.full(3, 1e-9))
    e = sharp.expand(Trajectory(np.zeros((2, 3)), np.zeros((1, 2))))
    assert all(np.isfinite(values).all() for values in vars(e).values())
    assert_array_equal(e.c_x, 0.0)


def test_the_cost_of_some_steps_is_a_part_of_the_whole(varying, rng):
    states, controls = rng.standard_normal((8, 3)), rng.standard_normal((8, 2))
    for first, steps in ((0, 5), (2, 2), (3, 5)):  # the last one goes on beyond the horizon
        part = varying.starting_at(first, steps)
        x, u = states[:steps], controls[:steps]
        assert_array_equal(part(x, u), varying(x, u, first))
        expansion = part.expand(Trajectory(states[: steps + 1], u))
        assert_allclose(expansion.c, varying(x, u, first), rtol=1e-12)


# The second target follows the first number of a context, the third one swings with the others.
FOLLOWING = Following(
    np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.6, 0.8]]),
    moving=np.ones(3),
    still=np.ones(3),
    stance=np.zeros((3, 3)),
    rest=np.zeros(1),
)
CONTEXT = np.array([[0.5, 1.0, 0.0], [0.5, 0.0, 1.0], [-2.0, -1.0, 0.5], [0.0, 0.0, 0.0]])


def test_targets_follow_the_context(cost, rng):
    cost = dataclasses.replace(cost, following=FOLLOWING)
    states, controls = rng.standard_normal((4, 3)), rng.standard_normal((4, 2))
    targets = [[1.0, -1.5, 1.1], [1.0, -1.5, 1.3], [1.0, -4.0, 0.5], [1.0, -2.0, 0.5]]
    parts = cost.in_context(CONTEXT).parts(states, controls)
    assert_allclose(parts, WEIGHTS * (Features()(states, controls) - targets) ** 2)
    assert_array_equal(FOLLOWING.follows, [False, True, True])


def test_a_weight_counts_while_a_command_is_at_rest_or_while_it_is_not(cost, rng):
    following = dataclasses.replace(
        FOLLOWING, moving=np.array([1.0, 1.0, 0.0]), still=np.array([1.0, 0.0, 1.0])
    )
    context = np.array([[0.5, 1.0, 0.0], [0.0, 1.0, 0.0]])
    assert_array_equal(following.factors(context), [[1.0, 1.0, 0.0], [1.0, 0.0, 1.0]])
    states, controls = rng.standard_normal((2, 3)), rng.standard_normal((2, 2))
    followed = dataclasses.replace(cost, following=FOLLOWING).in_context(context)
    always = followed.parts(states, controls)
    parts = dataclasses.replace(followed, following=following).parts(states, controls)
    assert_allclose(parts, always * following.factors(context))


def test_a_weight_of_a_stance_counts_while_the_foot_does_not_swing(cost):
    """The third weight belongs to a foot that is lifted by the last two numbers of a context."""
    following = dataclasses.replace(FOLLOWING, stance=-FOLLOWING.lifted / 0.5)
    factors = following.factors(CONTEXT)
    assert_array_equal(factors[:, :2], 1.0)
    assert_allclose(factors[:, 2], [0.0, 0.0, 0.4, 0.0])  # 0.4 = -(0.6 · -1 + 0.8 · 0.5) / 0.5
    assert_array_equal(following.follows, FOLLOWING.follows)


def test_a_plan_on_the_way_follows_the_context_of_its_steps(cost, rng):
    cost = dataclasses.replace(cost, following=FOLLOWING).in_context(CONTEXT)
    states, controls = rng.standard_normal((2, 3)), rng.standard_normal((2, 2))
    expected = cost(states, controls, 1)
    assert_array_equal(cost.starting_at(1, 2)(states, controls), expected)


def test_a_cost_that_follows_nothing_is_the_same_in_each_context(cost):
    assert cost.in_context(CONTEXT) is cost


def test_derivatives_of_a_cost_that_follows_are_along_state_and_control(
    cost, rng, finite_differences
):
    cost = dataclasses.replace(cost, following=FOLLOWING).in_context(CONTEXT)
    states, controls = rng.standard_normal((5, 3)), rng.standard_normal((4, 2))
    found = cost.expand(Trajectory(states, controls))
    by_state = finite_differences(lambda x: cost(x, controls).sum(), states[:-1])
    by_control = finite_differences(lambda u: cost(states[:-1], u).sum(), controls)
    assert_allclose(found.c_x, by_state, atol=1e-7)
    assert_allclose(found.c_u, by_control, atol=1e-7)
    assert_array_equal(found.c, cost.values(Trajectory(states, controls)))
