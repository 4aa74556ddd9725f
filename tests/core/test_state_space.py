# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.dynamics import StateSpace
from vgps_ros.simulation.model import state_space

# A free body that carries a hinge and a ball: quaternions at 3 and at 8.
MODEL = mujoco.MjModel.from_xml_string("""
<mujoco>
  <worldbody>
    <body name="base">
      <freejoint name="base"/>
      <geom size=".1"/>
      <body>
        <joint name="hinge"/>
        <geom size=".1"/>
        <body>
          <joint name="ball" type="ball"/>
          <geom size=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><general joint="hinge" dyntype="filter" dynprm="0.1"/></actuator>
</mujoco>
""")
SPACE = StateSpace(23, (3, 8))


@pytest.fixture
def states(rng):
    """Eight states with unit quaternions, in rows of four."""
    x = rng.standard_normal((2, 4, 23))
    for first in SPACE.quaternions:
        q = x[..., first : first + 4]
        q /= np.linalg.norm(q, axis=-1, keepdims=True)
    return x


def test_a_models_space_has_its_quaternions_and_activations():
    assert state_space(MODEL) == SPACE
    assert SPACE.tangent_dim == 2 * MODEL.nv + MODEL.na == 21


def test_adding_and_subtracting_are_the_simulators(states, rng):
    deviations = rng.uniform(-1, 1, (2, 4, 21))
    moved = SPACE.add(states, deviations)
    rows = (a.reshape(8, -1) for a in (states, deviations, moved))
    for x, delta, found in zip(*rows, strict=True):
        expected = x.copy()
        mujoco.mj_integratePos(MODEL, expected[: MODEL.nq], delta[: MODEL.nv], 1.0)
        expected[MODEL.nq :] += delta[MODEL.nv :]
        assert_allclose(found, expected, rtol=0, atol=1e-14)
        velocity = np.empty(MODEL.nv)
        mujoco.mj_differentiatePos(MODEL, velocity, 1.0, x[: MODEL.nq], found[: MODEL.nq])
        assert_allclose(SPACE.subtract(found, x)[: MODEL.nv], velocity, rtol=0, atol=1e-14)
    assert_allclose(SPACE.subtract(moved, states), deviations, rtol=0, atol=1e-13)


def test_one_state_is_moved_by_many_deviations_as_by_each_alone(states, rng):
    deviations = rng.uniform(-1, 1, (5, 21))
    moved = SPACE.add(states[0, 0], deviations)
    assert_array_equal(moved, [SPACE.add(states[0, 0], each) for each in deviations])
    assert_array_equal(
        SPACE.subtract(moved, states[0, 0]), [SPACE.subtract(x, states[0, 0]) for x in moved]
    )


def test_derivatives_are_carried_back_to_the_state_that_was_moved(states, rng, finite_differences):
    """With the deviation first, a rotation of the state before it turns in another frame."""
    x, delta, reading = states[0, 0], rng.uniform(-1, 1, 21), rng.standard_normal((3, 23))
    moved = SPACE.add(x, delta)
    there = finite_differences(lambda e: reading @ SPACE.add(moved, e), np.zeros(21))
    expected = finite_differences(
        lambda e: reading @ SPACE.add(SPACE.add(x, e), delta), np.zeros(21)
    )
    assert_allclose(SPACE.carried_back(there, delta), expected, atol=1e-8)
    for size in (1.0, 1e-3, 0.0):  # and by the deviation itself
        moved = SPACE.add(x, size * delta)
        there = finite_differences(lambda e, y=moved: reading @ SPACE.add(y, e), np.zeros(21))
        by_delta = finite_differences(lambda d: reading @ SPACE.add(x, d), size * delta)
        found = SPACE.carried_back(there, size * delta, by_deviation=True)
        assert_allclose(found, by_delta, atol=1e-8)


def test_a_rotation_is_taken_the_short_way_whatever_the_sign_of_its_quaternion(states):
    x = states[0, 0]
    flipped = x.copy()
    flipped[3:7] *= -1
    assert_allclose(SPACE.subtract(flipped, x), 0.0, atol=1e-14)


def test_a_state_that_diverged_stays_nan(states):
    x = states[0].copy()
    x[1] = np.nan
    found = SPACE.subtract(x, states[0])
    assert np.isnan(found[1, SPACE.plain[1]]).all()
    assert_allclose(found[[0, 2, 3]], 0.0, atol=1e-14)


def test_without_quaternions_it_is_plain_arithmetic(rng):
    x, y = rng.standard_normal((2, 3, 4))
    assert_array_equal(StateSpace(4).add(x, y), x + y)
    assert_array_equal(StateSpace(4).subtract(x, y), x - y)
