# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What no joint can measure, and how far a base may tilt, for any robot."""

import mujoco
import numpy as np
import pytest

from tests.motors import motors
from vgps_ros.robot.bodies import vertical
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.state_limits import StateLimits
from vgps_ros.safety.supervisor import Supervisor
from vgps_ros.simulation.frames import state_layout

CART = """
<mujoco model="cart">
  <compiler angle="radian"/>
  <worldbody>
    <body name="trunk" pos="0 0 1" {turn}>
      <freejoint name="root"/>
      <geom size=".1" mass="2"/>
      <body name="arm" pos="0 .2 0">
        <joint name="shoulder" axis="0 1 0" range="-1 2"/>
        <geom size=".05" mass=".1"/>
        <body name="hand"><joint name="wheel" axis="0 1 0"/><geom size=".04" mass=".1"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
PENDULUM = """
<mujoco><worldbody><body><joint name="a"/><geom size=".1"/><body><joint name="b"/>
<geom size=".1"/></body></body></worldbody></mujoco>
"""
WRONG = np.array([9.0, 0.0, 50.0, 0.0])
ON = SafetySettings(tilt_limit=1.2, joint_margin=0.5, joint_speed_limit=100.0)


def limits(settings=ON, turn=""):
    model = mujoco.MjModel.from_xml_string(CART.format(turn=turn))
    upright = np.concatenate([model.qpos0, np.zeros(model.nv)])
    return StateLimits(settings, state_layout(model), upright), upright


def turned(state, axis, angle):
    """The state whose base is turned further, about an axis of its own."""
    turn, found = np.empty(4), state.copy()
    mujoco.mju_axisAngle2Quat(turn, np.array(axis, dtype=float), angle)
    mujoco.mju_mulQuat(found[3:7], state[3:7], turn)
    return found


@pytest.mark.parametrize("turn", ["", 'euler="0.5 0 0.3"'])
def test_a_base_may_tilt_as_far_as_the_limit_from_how_it_starts(turn):
    found, upright = limits(turn=turn)
    assert found.tilted(upright) == ""
    level = np.linalg.svd(vertical(upright[3:7])[None])[2][1]  # about which it tilts
    for angle in (1.19, -1.19):
        assert found.tilted(turned(upright, level, angle)) == ""
    for angle in (1.21, np.pi, -2.0):
        assert found.tilted(turned(upright, level, angle)) == (
            f"the base is tilted by {abs(angle):.2f} rad, but tilt_limit is 1.2 rad; set the robot "
            "upright, or let it stand up."
        )


def test_a_heading_is_no_tilt():
    found, upright = limits()
    for angle in (1.5, 3.0, -2.0):
        assert found.tilted(turned(upright, [0, 0, 1], angle)) == ""


@pytest.mark.parametrize(
    ("place", "value", "sentence"),
    [
        (7, 2.49, ""),
        (7, -1.49, ""),
        (7, 2.51, "shoulder is measured at 2.51, but its range is -1 to 2"),
        (7, 100.0, "shoulder is measured at 100, but its range is -1 to 2"),
        (7, -1e300, "shoulder is measured at -1e+300, but its range is -1 to 2"),
        (8, 1e3, ""),  # it may turn for ever
        (15, 99.0, ""),
        (15, -101.0, "shoulder is measured to move at -101 in a second"),
        (16, 1e300, "wheel is measured to move at 1e+300 in a second"),
    ],
)
def test_a_joint_far_beyond_its_range_or_too_fast_was_measured_wrongly(place, value, sentence):
    found, state = limits()
    state[place] = value
    assert found.misread(state).startswith(sentence)
    assert bool(found.misread(state)) == bool(sentence)


def test_without_limits_every_state_is_believed():
    found, state = limits(SafetySettings())
    state[7:9], state[15:] = 1e300, 1e300
    assert found.misread(state) == found.tilted(turned(state, [1, 0, 0], np.pi)) == ""


def test_a_state_that_was_misread_is_used_for_nothing():
    controls, good = motors(10.0, 10.0), np.array([0.1, 0.2, 1.0, -2.0])
    settings = SafetySettings(safe_action="damping", damping=2.0, joint_speed_limit=40.0)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    limits = StateLimits(settings, state_layout(model), np.zeros(4))
    supervisor = Supervisor(settings, controls, 0.02, limits=limits)
    torques, asked = np.array([3.0, -4.0]), list[np.ndarray]()

    def law(state):
        return lambda: asked.append(state) or torques

    def send(state, step):
        return supervisor.answer(state, step, lambda: 0.0, 0.02 * step, law(state))

    assert send(good + WRONG, 1) is None  # nothing is known that would be safe
    assert send(good, 2).control.tolist() == [3.0, -4.0]
    braked = send(good + WRONG, 3)
    assert supervisor.fault.startswith("a is measured to move at 51 in a second")
    assert braked.control.tolist() == [-2.0, 4.0]  # of the state before
    assert send(good, 4).control.tolist() == [3.0, -4.0]
    assert len(asked) == 2
