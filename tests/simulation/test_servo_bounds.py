# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Servos whose force ends at a limit: which targets act, and what a solve makes of them."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.tasks.solving import solved
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.tasks import make_task

# An arm beside a free body, whose quaternion makes x longer than δ.
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.01" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body pos="0 3 0"><freejoint name="base"/><geom size=".1" mass="1"/></body>
    <body>
      <joint name="hinge" axis="0 1 0" armature="0.1" damping="0.1" range="-4 4" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02" mass="1"/>
    </body>
  </worldbody>
  <actuator>{}</actuator>
</mujoco>
"""
MOTOR = '<motor joint="hinge" ctrlrange="-2 2" ctrllimited="true"/>'
SERVO = '<position joint="hinge" kp="{}" kv="0.5" forcerange="-2 2" inheritrange="1"/>'
# The hinge goes to 2 rad, as fast as 2 N·m let it; controls cost next to nothing.
TASK = """
model: arm.xml
control_period: 0.02
horizon: 1.0
cost:
  - {{sensor: hinge/position, target: 2.0, weight: 1.0}}
  - {{control: all, weight: {}}}
observe: [joint_positions, joint_velocities]
"""


def arm(actuator: str) -> Dynamics:
    return Dynamics(mujoco.MjModel.from_xml_string(ARM.format(actuator)), 2)


def at(dynamics: Dynamics, position: float, velocity: float) -> np.ndarray:
    model = dynamics.model
    state = np.r_[model.qpos0, np.zeros(model.nv)]
    state[[7, model.nq + 6]] = position, velocity
    return state


def test_a_servos_targets_end_where_its_force_does():
    servo, expected = arm(SERVO.format(40.0)), np.zeros(14)
    expected[[6, 13]] = 1.0, 0.5 / 40.0
    found = servo.bounds_along(np.array([at(servo, 0.3, 2.0)] * 2))
    # ±2 N·m = 40 (u − 0.3) − 0.5 · 2
    assert_allclose([found.lowest[0, 0], found.highest[0, 0]], [0.275, 0.375], atol=1e-4)
    assert_allclose(found.slopes, [[[expected]]] * 2)
    # Beyond the model's limit no target is allowed, whatever it would bring.
    found = servo.bounds_along(np.array([at(servo, 3.99, 0.0)] * 2))
    assert_allclose([found.lowest[0, 0], found.highest[0, 0]], [3.94, 4.0], atol=1e-4)
    assert_allclose(found.slopes, [[[expected]], [[np.zeros(14)]]])


@pytest.mark.parametrize(
    "actuator",
    [
        MOTOR,
        SERVO.format(40.0).replace('forcerange="-2 2"', ""),
        '<velocity joint="hinge" kv="40" forcerange="-2 2" ctrlrange="-4 4"/>',
        '<general joint="hinge" dyntype="filter" dynprm="1" gainprm="40" biastype="affine" '
        'biasprm="0 -40" forcerange="-2 2" ctrlrange="-4 4"/>',  # whose force follows later
    ],
)
def test_what_is_no_servo_with_a_limit_keeps_the_limits_of_the_model(actuator):
    dynamics = arm(actuator)
    rows = np.zeros((4, dynamics.state_dim))
    rows[:, 3] = 1.0
    found = dynamics.bounds_along(rows)
    assert found.slopes is None
    for bound, limit in zip((found.lowest, found.highest), dynamics.control_limits, strict=True):
        assert_array_equal(bound, np.tile(limit, (3, 1)))


@pytest.mark.parametrize(("substeps", "gains_speed"), [(1, False), (2, True)])
def test_a_farther_target_acts_only_after_the_first_simulator_step(substeps, gains_speed):
    servo = Dynamics(mujoco.MjModel.from_xml_string(ARM.format(SERVO.format(40.0))), substeps)
    start = at(servo, 0.0, 0.8)
    end = servo.bounds_along(np.array([start] * 2)).highest[0]
    bounded, beyond = (servo.step(start, u)[-1] - 0.8 for u in (end, end + 0.02))
    # Some percent are the integrator's, whose damping ends with the servo's answer.
    assert (beyond > 1.05 * bounded) == gains_speed


def test_a_servo_that_passes_its_range_in_a_step_keeps_the_limits_of_the_model():
    servo = arm(SERVO.format(40.0))
    found = servo.bounds_along(np.array([at(servo, y, 0.0) for y in (0.0, 0.024, 0.05)]))
    assert_allclose(found.highest[:, 0], [0.05, 4.0], atol=1e-4)
    assert found.slopes.any(axis=(0, 2, 3)).tolist() == [True, False]


def test_a_solve_makes_of_a_servo_what_it_makes_of_a_motor_of_the_same_strength(tmp_path):
    def cost(name: str, actuator: str, weight: float) -> float:
        folder = tmp_path / name
        folder.mkdir()
        (folder / "arm.xml").write_text(ARM.format(actuator))
        (folder / "task.yaml").write_text(TASK.format(weight))
        return solved(make_task(str(folder / "task.yaml")), 40).modified_cost

    motor = cost("motor", MOTOR, 1e-5)
    for kp in (10.0, 40.0, 160.0):
        # A servo's force falls within a control period, as a motor's does not.
        assert cost(f"servo{kp:g}", SERVO.format(kp), 1e-5) == pytest.approx(motor, rel=0.04)
