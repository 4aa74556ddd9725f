# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Kinds, units and transmissions of controls, against MuJoCo's own forces and by hand."""

import mujoco
import numpy as np
import pytest

from tests.motors import robot
from vgps_ros.simulation.controls import controls_of, resting_controls

KINDS = {
    '<motor joint="{}"/>': ("torque", "N·m"),
    '<motor joint="{}" gear="-50"/>': ("torque", "N·m"),
    '<general joint="{}" dyntype="filter" dynprm=".05" gainprm="2"/>': ("torque", "N·m"),
    '<position joint="{}" kp="120"/>': ("position", "rad"),
    '<position joint="{}" kp="40" kv="3" gear="6"/>': ("position", "rad"),
    # As of Franka's hand: 0 to 255 for a range of positions, from an offset.
    '<general joint="{}" gainprm=".5" biastype="affine" biasprm="3 -100 -10" gear="2"/>': (
        "position",
        "rad",
    ),
    '<velocity joint="{}" kv="5" gear="3"/>': ("velocity", "rad/s"),
    '<intvelocity joint="{}" kp="70" gear="2" actrange="-9 9"/>': ("velocity", "rad/s"),
    '<damper joint="{}" kv="2" ctrlrange="0 1"/>': ("activation", "1"),
    '<cylinder joint="{}" area="3"/>': ("torque", "N·m"),
    '<general joint="{}" dyntype="integrator"/>': ("activation", "1"),
}
MODEL = robot(*KINDS)
CONTROLS = controls_of(MODEL)
DIRECT = [i for i in range(MODEL.nu) if MODEL.actuator_dyntype[i] == 0]


@pytest.fixture
def state(rng):
    x = rng.standard_normal(MODEL.nq + MODEL.nv + MODEL.na)
    x[MODEL.nq + MODEL.nv :] = 0.0
    return x


def forces(state, control):
    """MuJoCo's forces of the actuators on their joints."""
    data = mujoco.MjData(MODEL)
    data.qpos[:], data.qvel[:], data.ctrl[:] = *np.split(state[: 2 * MODEL.nv], 2), control
    mujoco.mj_forward(MODEL, data)
    return data.qfrc_actuator.copy()


def test_each_control_has_a_kind_and_a_unit():
    assert list(zip(CONTROLS.kinds, CONTROLS.units, strict=True)) == list(KINDS.values())
    # What keeps its force at u = 0 has nothing that leaves the robot alone.
    assert CONTROLS.restless == (f"j{len(KINDS) - 1}",)


def test_a_posed_servo_exerts_no_force_and_other_controls_are_zero(state):
    data = mujoco.MjData(MODEL)
    data.qpos[:] = state[: MODEL.nq]
    mujoco.mj_forward(MODEL, data)
    control, servos = resting_controls(data), CONTROLS.are("position")
    assert servos.sum() == 3
    assert not control[~servos].any()
    state[MODEL.nq : 2 * MODEL.nq] = 0.0
    np.testing.assert_allclose(forces(state, control)[servos], 0.0, atol=1e-12)


def test_the_force_on_a_joint_is_mujocos_for_any_control_and_state(state, rng):
    control = rng.standard_normal(MODEL.nu)
    q, v = np.split(state[: 2 * MODEL.nv], 2)
    c = CONTROLS
    found = c.strength * control + c.bias - c.stiffness * q - c.damping * v
    known = [i for i in DIRECT if c.kinds[i] != "activation"]
    np.testing.assert_allclose(found[known], forces(state, control)[known], rtol=1e-12)


def test_at_rest_no_actuator_pulls_a_joint_that_stands(state):
    state[MODEL.nq :] = 0.0
    found = forces(state, CONTROLS.resting(state))
    np.testing.assert_allclose(found[DIRECT], 0.0, atol=1e-9)


def test_values_at_the_joints_and_controls_are_inverse(rng):
    control = rng.standard_normal(MODEL.nu)
    back = CONTROLS.from_joints(CONTROLS.at_joints(control))
    np.testing.assert_allclose(back, control, rtol=1e-12)
    by_hand = {1: -50.0 * control[1], 3: control[3], 4: control[4] / 6, 6: control[6] / 3}
    by_hand[5] = (0.5 * control[5] + 3.0) / (2 * 100.0)  # the length is twice the angle
    for i, expected in by_hand.items():
        assert CONTROLS.at_joints(control)[i] == pytest.approx(expected, rel=1e-12)


def test_within_the_bounds_of_a_torque_mujoco_exerts_no_more(state):
    largest = np.full(MODEL.nu, 1.7)
    servos = [i for i in DIRECT if CONTROLS.kinds[i] != "activation"]
    for side, control in zip((-1, 1), CONTROLS.bounds(state, largest), strict=True):
        found = np.sort([forces(state, control), side * largest], axis=0)
        np.testing.assert_allclose(np.abs(found[:, servos]), 1.7, rtol=1e-9)


def test_an_unknown_actuator_or_a_servo_of_a_site_is_restless():
    mjcf = """<mujoco><worldbody><body><freejoint name="base"/><geom size=".1"/>
      <site name="here"/></body></worldbody><actuator>
      <motor name="thrust" site="here" gear="0 0 3 0 0 0"/>
      <position name="place" site="here" kp="4" gear="1 0 0 0 0 0"/></actuator></mujoco>"""
    found = controls_of(mujoco.MjModel.from_xml_string(mjcf))
    assert found.restless == ("place",)
    assert (found.kinds[0], found.units[0], found.strength[0]) == ("force", "N", 3.0)
    assert not found.are_braked[0]
