# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""How strong a robot's motors are, and where their controls work hard."""

import mujoco
import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.robot.controls import Controls
from vgps_ros.wizard.legged_scale import legged_numbers, servo_reach, strongest
from vgps_ros.wizard.robot import HINGE, Robot, legs_of

_UNKNOWN_REACH = 0.8  # of a servo whose force has no limit: the target at which it is strong [rad]
_LAGGING = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)  # a first-order lag [s]
_AT_JOINT = mujoco.mjtTrn.mjTRN_JOINT


def motor_strength(robot: Robot, joint: int) -> float:
    """Returns a limit for a joint's motor [N·m]: what the model allows, or what its load asks."""
    model = robot.model
    known = (robot.strengths or {}).get(model.joint(joint).name, 0.0)
    if not known and model.jnt_actfrclimited[joint]:
        known = float(np.abs(model.jnt_actfrcrange[joint]).max())
    known = known or float(f"{joint_load(robot, joint):.3g}")
    return min(known, strongest(robot)) if robot.feet else known


def joint_load(robot: Robot, joint: int) -> float:
    """Returns the torque that moves and carries what hangs at a joint [N·m]."""
    model, data = robot.model, robot.data
    body, is_leg = int(model.jnt_bodyid[joint]), any(joint in leg for leg in legs_of(robot))
    far = float(np.linalg.norm(data.subtree_com[body] - data.xanchor[joint]))
    gyration = model.body_inertia[body].max() / max(model.body_mass[body], 1e-9)
    far = max(far, float(gyration) ** 0.5)  # of what is balanced on its joint
    carried = 0.5 * robot.mass * robot.leg
    load = max(3 * model.body_subtreemass[body] * far, carried if is_leg else 0.0)
    return float((robot.gravity or 9.81) * load)


def lag_gains(robot: Robot) -> Array:
    """Returns the squared gain that compensates each actuator's lag at the clock's rate.

    An actuator that lags needs larger commands, the faster the robot steps.
    """
    rate = legged_numbers(robot)["rate"] if robot.feet else 0.0
    kinds, numbers = robot.model.actuator_dyntype, robot.model.actuator_dynprm
    lags = np.isin(kinds, [int(kind) for kind in _LAGGING])
    return np.asarray(1.0 + (2 * np.pi * rate * np.where(lags, numbers[:, 0], 0.0)) ** 2)


def working_reach(robot: Robot, controls: Controls, i: int) -> float:
    """Returns by how much a servo's control differs from its pose where it works hard.

    A control there costs as much as a motor at its limit. It is where the servo's force is
    greatest; a hinge of a robot with legs gets at least what a step takes.
    """
    model, stiffness = robot.model, controls.stiffness[i]
    joint, force = int(model.actuator_trnid[i, 0]), controls.servo_forces[i]
    reach = force / stiffness if force < 1e6 else _UNKNOWN_REACH
    if not robot.feet:
        reach = min(reach, 1.0)
    elif model.actuator_trntype[i] == _AT_JOINT and model.jnt_type[joint] == HINGE:
        damping = controls.damping[i] + float(model.dof_damping[model.jnt_dofadr[joint]])
        reach = max(reach, servo_reach(robot, stiffness, damping, joint_load(robot, joint)))
    return float(reach / abs(controls.scale[i]))
