"""The swimmer's cost and symmetry against the simulator's own velocities."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.tasks import make_task
from vgps_ros.tasks.swimmer import centre_of_mass_velocity

SWIMMER = make_task("swimmer")
states = arrays(float, 10, elements=st.floats(-4, 4))


def simulated_velocity(state):
    model = SWIMMER.dynamics.model
    data = mujoco.MjData(model)
    data.qpos, data.qvel = state[:5], state[5:]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return data.subtree_linvel[0, 0]


@given(states)
def test_centre_of_mass_velocity_is_the_simulators(state):
    assert_allclose(centre_of_mass_velocity(state)[0], [simulated_velocity(state)], atol=1e-12)


@given(states)
def test_its_jacobian_agrees_with_finite_differences_of_the_simulators(state):
    jacobian, eps = centre_of_mass_velocity(state)[1], 1e-5
    for i, step in enumerate(eps * np.eye(10)):
        difference = simulated_velocity(state + step) - simulated_velocity(state - step)
        assert_allclose(jacobian[0, i], difference / (2 * eps), atol=1e-8)


def test_velocities_of_many_states_are_those_of_each(rng):
    batch = rng.standard_normal((3, 4, 10))
    velocity, jacobian = centre_of_mass_velocity(batch)
    assert (velocity.shape, jacobian.shape) == ((3, 4, 1), (3, 4, 1, 10))
    single = centre_of_mass_velocity(batch[2, 1])
    assert_array_equal(velocity[2, 1], single[0])
    assert_array_equal(jacobian[2, 1], single[1])


def test_cost_of_a_step_is_the_papers(rng):
    state, control = rng.standard_normal(10), 50 * rng.standard_normal(2)
    expected = 1e-5 * control @ control + (simulated_velocity(state) - 1.0) ** 2
    assert SWIMMER.cost(state, control) == pytest.approx(expected, rel=1e-12)


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
