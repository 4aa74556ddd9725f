# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What swings up: a pendulum, or a thing beside a robot, which it catches or turns."""

from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.simulation.controls import controls_of
from vgps_ros.wizard.robot import HINGE, Robot, free_object_joint, touching_geoms, weak_motors
from vgps_ros.wizard.targets import carries_object, target_sensor


def swings_up(robot: Robot) -> bool:
    """Returns whether the robot swings itself, or a thing beside it that it catches or turns."""
    return robot.kind == "pendulum" or carries_object(robot) or hinge_to_turn(robot) is not None


def swing_time(robot: Robot) -> float:
    """Returns the time in which a pendulum swings up and then stands for a while [s].

    Weak motors need several swings: they pull with all their force in the direction in which their
    joints turn, until the energy is that of the goal. Nobody swings up faster.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    weak = weak_motors(robot)
    if not weak:
        return 4.0
    full, dofs = controls_of(model).limits[1], model.jnt_dofadr[[robot.motors[i] for i in weak]]

    def energy() -> float:
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        return float(data.energy.sum())

    data.qpos[:] = robot.goal
    goal, data.qpos[:] = energy(), robot.data.qpos
    while energy() < goal and data.time < 10.0:
        data.ctrl[weak] = np.where(data.qvel[dofs] >= 0.0, full[weak], -full[weak])
        mujoco.mj_step(model, data)
    return float(np.clip(np.ceil(2.0 * data.time), 8.0, 16.0))


def hinge_to_turn(robot: Robot) -> int | None:
    """Returns the hinge of a thing beside the robot that only its touch turns, if there is one."""
    model, thing = robot.model, free_object_joint(robot)
    if thing is None or model.jnt_type[thing] != HINGE:
        return None
    own = model.geom_bodyid == model.jnt_bodyid[thing]
    is_touched = bool((own & touching_geoms(model)).any())
    return thing if is_touched and not robot.base and target_sensor(robot) is None else None


def endless_hinges(robot: Robot) -> list[int]:
    """Returns the hinges of a pendulum that turn without end, so that sine and cosine count."""
    is_one = robot.kind == "pendulum"
    return [j for j in robot.hinges if is_one and not robot.model.jnt_limited[j]]


def upright_axes(robot: Robot) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Returns the axes of a pendulum's links that shall point up: sensor and cost by hinge.

    The sensor is of an axis of the link, and the cost's weight its share of what is lifted.
    A link's direction in the world counts, not the angle of its hinge: so a link at the end of
    others may swing as they need it, and each counts as much as gravity does about its hinge.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.goal
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    found = dict[int, tuple[str, Array, float]]()
    turning = endless_hinges(robot)
    for j in turning:
        body = int(model.jnt_bodyid[j])
        axes = data.xmat[body].reshape(3, 3).T
        axes[np.abs(axes @ data.xaxis[j]) > 0.7] = 0.0  # those that a turn does not move
        i = int(np.abs(axes[:, 2]).argmax())
        own, place = float(model.body_mass[body]), data.xanchor[j]
        moment = own * (data.xipos[body] - place)
        for child in np.flatnonzero(model.body_parentid == body):
            hinges = [k for k in turning if model.jnt_bodyid[k] == child]
            at = data.xanchor[hinges[0]] if hinges else data.subtree_com[child]
            moment = moment + model.body_subtreemass[child] * (at - place)
        is_level = abs(data.xaxis[j][2]) > 0.7  # gravity does not turn it
        if not is_level and (size := float(np.linalg.norm(moment))) > 1e-9:
            found[j] = ("xyz"[i], axes[i].round(3), size)
    total = sum((size for *_, size in found.values()), 0.0)
    return {
        model.joint(j).name: (
            {"type": f"frame{axis}axis", "xbody": model.body(model.jnt_bodyid[j]).name},
            {"target": target.tolist(), "weight": float(f"{size / total:.3f}")},
        )
        for j, (axis, target, size) in found.items()
    }
