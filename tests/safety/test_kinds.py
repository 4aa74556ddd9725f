# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a servo robot and a geared one get: each safe action, limit and stop, by hand."""

import mujoco
import numpy as np
import pytest

from tests.motors import robot
from tests.servo_arm import GEARED, SERVOS
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.supervisor import Supervisor
from vgps_ros.simulation.controls import controls_of

PERIOD = 0.02  # [s]
SERVO, MOTOR = (controls_of(mujoco.MjModel.from_xml_string(mjcf)) for mjcf in (SERVOS, GEARED))
ARM = np.array([-0.7, 0.5, 0.3, -1.2])  # shoulder and elbow, then their velocities
ROD = np.array([-0.7, 2.0])


class Robot:
    """A supervisor and a clock."""

    def __init__(self, controls, **settings):
        self.supervisor = Supervisor(SafetySettings(**settings), controls, PERIOD)
        self.supervisor.begin()
        self.now, self.step = 0.0, 0

    def send(self, state, control):
        """What answers a state of which the policy wants a control; NaN is a fault."""
        self.now, self.step = self.now + PERIOD, self.step + 1
        wanted = np.array(control, dtype=float)
        stamp = round(self.step * PERIOD * 1e9)
        found = self.supervisor.answer(state, stamp, lambda: 0.0, self.now, lambda: wanted)
        return found.control.tolist()


BAD_2, BAD_1 = [np.nan] * 2, [np.nan]


@pytest.mark.parametrize("action", ["zero", "damping"])
def test_servos_hold_the_pose_that_was_measured_when_the_policy_stopped(action):
    arm = Robot(SERVO, safe_action=action)
    assert arm.send(ARM, [0.4, -0.6]) == [0.4, -0.6]
    assert arm.send(ARM, BAD_2) == [0.5, -0.7]  # elbow and shoulder, in the actuators' order
    # As the arm sinks into its servos, it must not be followed.
    assert arm.send(ARM + 0.1, BAD_2) == [0.5, -0.7]
    assert arm.supervisor.watch(arm.now + 100.0).control.tolist() == [0.5, -0.7]
    assert arm.supervisor.stop().control.tolist() == [0.5, -0.7]
    assert arm.send(ARM, [0.4, -0.6]) == [0.4, -0.6]
    assert arm.send(ARM + 0.1, BAD_2) == pytest.approx([0.6, -0.6])  # of the new fault


def test_a_stop_leaves_servos_where_they_are_and_motors_without_torque():
    for controls, state, wanted, rest in (
        (SERVO, ARM, [0.4, -0.6], [0.5, -0.7]),
        (MOTOR, ROD, [0.9], [0.0]),
    ):
        one = Robot(controls)
        assert one.supervisor.stop() is None
        one.send(state, wanted)
        assert one.supervisor.stop().control.tolist() == rest


def test_damping_is_that_of_the_joint_behind_the_gear():
    rod = Robot(MOTOR, safe_action="damping", damping=1.0)
    (control,) = rod.send(ROD, BAD_1)
    assert 50 * control == -1.0 * 2.0  # N·m = −N·m·s/rad · rad/s
    assert Robot(MOTOR, safe_action="zero").send(ROD, BAD_1) == [0.0]


def test_a_torque_limit_is_that_of_the_joint_behind_the_gear():
    rod = Robot(MOTOR, torque_limits=(5.0,))
    assert rod.send(ROD, [0.9]) == [5.0 / 50]
    assert rod.send(ROD, [-0.9]) == [-5.0 / 50]
    assert rod.send(ROD, [0.01]) == [0.01]
    assert MOTOR.largest.tolist() == [50.0]


def test_a_torque_limit_keeps_a_servos_target_near_the_joint():
    arm = Robot(SERVO, torque_limits=(6.0, 24.0))
    # τ = k_p (target − position): ±6 / 60 around the elbow, ±24 / 120 around the shoulder.
    assert arm.send(ARM, [2.0, -3.0]) == pytest.approx([0.5 + 0.1, -0.7 - 0.2])
    assert arm.send(ARM, [0.45, -0.6]) == [0.45, -0.6]


def test_the_rate_limit_ramps_from_the_measured_pose_and_by_the_torque():
    arm = Robot(SERVO, torque_rate_limit=120.0)  # 2.4 N·m in a period
    first = np.array([0.5 + 2.4 / 60, -0.7 - 2.4 / 120])
    assert arm.send(ARM, [2.0, -3.0]) == pytest.approx(first.tolist())
    assert arm.send(ARM, [2.0, -3.0]) == pytest.approx((2 * first - [0.5, -0.7]).tolist())
    rod = Robot(MOTOR, torque_rate_limit=120.0)
    assert rod.send(ROD, [0.9]) == pytest.approx([2.4 / 50])


def test_servos_of_velocities_brake_and_muscles_relax():
    model = robot('<velocity joint="{}" kv="5"/>', '<damper joint="{}" kv="2" ctrlrange="0 1"/>')
    controls, state = controls_of(model), np.array([0.1, 0.2, 1.0, -2.0])
    assert Robot(controls).send(state, BAD_2) == [0.0, 0.0]
    assert controls.at_rest == "servos brake and the activations are zero"


def test_what_has_no_safe_action_is_refused_in_a_sentence():
    muscle = controls_of(robot('<damper joint="{}" kv="2" ctrlrange="0 1"/>'))
    sentence = "safe_action is damping, but no state tells the velocity that the control of j0"
    with pytest.raises(InvalidInputError, match=sentence):
        Robot(muscle, safe_action="damping")
    valve = controls_of(robot('<general joint="{}" dyntype="integrator"/>'))
    with pytest.raises(InvalidInputError, match="The control of j0 has no safe action"):
        Robot(valve)


def test_a_limit_that_the_models_own_excludes_is_refused():
    tense = controls_of(robot('<motor joint="{}" gear="10" ctrlrange="0.5 1"/>'))
    with pytest.raises(InvalidInputError, match=r"limits of j0 demand a torque of 5 at least"):
        Robot(tense, torque_limits=(4.0,))


SHORT = SERVOS.replace('kp="120"', 'kp="120" ctrlrange="-1 1.3" forcerange="-24 24"')


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_servo_measured_beyond_its_control_stays_there_or_comes_back_softly(side):
    controls = controls_of(mujoco.MjModel.from_xml_string(SHORT))
    there = np.array([6.33 * side, 0.5, 0.0, 0.0])
    arm = Robot(controls)
    assert arm.send(there, BAD_2) == [0.5, 6.33 * side]  # which asks for no torque
    assert arm.supervisor.stop().control.tolist() == [0.5, 6.33 * side]
    for torque in (24.0, 6.0):
        arm = Robot(controls, torque_limits=(1e9, torque))
        _, target = arm.send(there, [0.4, 0.2])
        assert 120.0 * (target - 6.33 * side) == pytest.approx(-torque * side)
    _, target = Robot(controls).send(np.array([1.4 * side, 0.5, 0.0, 0.0]), [0.4, 0.2])
    assert target == pytest.approx(0.2)  # no torque is limited
