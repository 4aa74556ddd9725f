# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The swimmer's sensor of velocity against a closed form, its cost, and its symmetry."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks import make_task

SWIMMER = make_task("swimmer")
VELOCITY = Readings(SWIMMER.dynamics.simulations, ["velocity/x", "velocity/y"])
states = arrays(float, 10, elements=st.floats(-4, 4))


def centre_of_mass_velocity(state):
    """v_x, v_y [m/s].

    The links are alike, so the centre of mass lies at p + (e(a) − e(b)) / 6, where p is the middle
    of the middle link and e(a), e(b) are unit vectors along the front and the back link.
    """
    _, _, yaw, front, back, v_x, v_y, yaw_rate, front_rate, back_rate = state
    a, a_rate = yaw + front, yaw_rate + front_rate
    b, b_rate = yaw + back, yaw_rate + back_rate
    return np.array(
        [
            v_x + (np.sin(b) * b_rate - np.sin(a) * a_rate) / 6,
            v_y + (np.cos(a) * a_rate - np.cos(b) * b_rate) / 6,
        ]
    )


@given(states)
def test_the_sensor_of_velocity_is_that_of_the_centre_of_mass(state):
    assert_allclose(VELOCITY(state), centre_of_mass_velocity(state), atol=1e-12)


@given(states)
def test_its_jacobian_agrees_with_finite_differences_of_the_closed_form(state):
    velocity, by_state, by_control = VELOCITY.linearize(state)
    assert_array_equal(velocity, VELOCITY(state))
    assert_array_equal(by_control, np.zeros((2, 2)))
    eps = 1e-5
    for i, step in enumerate(eps * np.eye(10)):
        plus, minus = centre_of_mass_velocity(state + step), centre_of_mass_velocity(state - step)
        assert_allclose(by_state[:, i], (plus - minus) / (2 * eps), atol=1e-6)


def test_velocities_of_many_states_are_those_of_each(rng):
    batch = rng.standard_normal((3, 4, 10))
    velocity, jacobian, _ = VELOCITY.linearize(batch)
    assert (velocity.shape, jacobian.shape) == ((3, 4, 2), (3, 4, 2, 10))
    single = VELOCITY.linearize(batch[2, 1])
    assert_array_equal(velocity[2, 1], single[0])
    assert_array_equal(jacobian[2, 1], single[1])


def test_cost_of_a_step_is_the_papers(rng):
    state, control = rng.standard_normal(10), 50 * rng.standard_normal(2)
    model = SWIMMER.dynamics.model
    data = mujoco.MjData(model)
    data.qpos, data.qvel = state[:5], state[5:]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    expected = 1e-5 * control @ control + (data.subtree_linvel[0, 0] - 1.0) ** 2
    assert SWIMMER.cost(state[None], control[None]) == pytest.approx([expected], rel=1e-12)


def test_swimming_is_the_same_everywhere_and_in_every_heading(rng):
    """Neither root position nor root yaw enters the dynamics, up to the frame of reference."""
    state, control, angle = rng.uniform(-1, 1, 10), rng.uniform(-30, 30, 2), 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def moved(x):
        x = x.copy()
        x[:2], x[5:7] = turn @ x[:2] + turn @ [3.0, -2.0], turn @ x[5:7]
        x[2] += angle
        return x

    step = SWIMMER.dynamics.step
    assert_allclose(step(moved(state), control), moved(step(state, control)), atol=1e-9)
