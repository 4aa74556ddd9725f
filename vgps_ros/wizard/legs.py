# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What only robots with legs get in their task: commands, a mirror, contacts, steps of the feet."""

import re
from copy import copy
from typing import Any

import mujoco
import numpy as np

from vgps_ros.simulation.controls import resting_controls
from vgps_ros.tasks.builder import swap_parts
from vgps_ros.tasks.schema import MOST_CONTACTS
from vgps_ros.wizard.legged_scale import legged_numbers, servo_numbers
from vgps_ros.wizard.motors import lag_gains, motor_strength
from vgps_ros.wizard.robot import HINGE, Robot, bottoms_of, ground_of, ground_planes, touching_geoms

_ALIKE = 0.04  # of a leg, within which two joints' axes are one line
_LOW = 0.15  # of a leg, up to which the middle of a foot that is down lies above the ground
FALLEN = 0.55  # of its height, below which a robot with legs lies


def command_values(robot: Robot) -> dict[str, Any]:
    """Returns the template's facts about commands, noise and the mirror of a robot with legs."""
    return {
        "sideways": robot.is_free and robot.forward[0] == "x",
        "turns": robot.is_free,
        # The cheaper a late control is, the wilder would be its noise, which learning must hear
        # the motion through.
        "alphas": [scale * lag_gains(robot).max(initial=1.0) for scale in (0.4, 1.2)],
        "mirror": _mirror(robot),
    }


def _mirror(robot: Robot) -> dict[str, Any]:
    """Returns the exchange of left and right, if joints' places, axes and names have one.

    Where along its axis a joint is anchored says nothing, but on which side of the robot it is.
    """
    model, data, joints = robot.model, robot.data, robot.joints
    if not robot.is_free or len(robot.feet) < 2 or robot.forward[0] != "x":
        return {}
    anchors = (data.xanchor - data.xpos[robot.root]) @ robot.frame
    axes = data.xaxis @ robot.frame
    near = _ALIKE * robot.leg  # distance of two lines that are one
    motors = {joint: model.actuator(i).name for i, joint in robot.motors.items()}
    swaps, flips, pairs = set[tuple[str, str]](), list[str](), dict[str, str]()
    for j in joints:
        image = axes[j] * ([-1, 1, -1] if model.jnt_type[j] == HINGE else [1, -1, 1])
        aside = anchors[j] * [1, -1, 1] - anchors[joints]
        of_lines = np.linalg.norm(np.cross(aside, axes[joints]), axis=1)
        alike = (of_lines < near) & (np.abs(axes[joints] @ image) > 0.99)
        if not alike.any():
            return {}
        k = joints[int(np.argmin(np.where(alike, np.linalg.norm(aside, axis=1), np.inf)))]
        for names in ({k: model.joint(k).name for k in joints}, motors):
            one, other = names.get(j, ""), names.get(k, "")
            pairs[one] = other
            parts = zip(*(re.split(r"([^A-Za-z]+)", n) for n in (one, other)), strict=False)
            swaps |= {(a, b) for a, b in parts if "" < a < b}
            flips += [one] if one and one not in flips and image @ axes[k] < 0 else []
    up, turning, velocity = (robot.new_sensor(name) for name in ("up", "turning", "velocity"))
    pairs |= {up: up, turning: turning}
    if any(swap_parts(a, sorted(swaps)) != b for a, b in pairs.items()):
        return {}
    flips += [f"{velocity}/y"] if robot.is_biped else []
    flips += [f"{up}/y", f"{turning}/[xz]", "command/sideways", "command/turn", "clock/*"]
    return {"swap": [list(pair) for pair in sorted(swaps)], "flip": flips}


def foot_contacts(robot: Robot) -> list[list[str]]:
    """Returns the pairs of a ground and a foot, if all have names and nothing else moves."""
    model = robot.model
    if not robot.in_tree(model.dof_bodyid).all():  # a target, which `edit_model` leaves
        return []
    feet = np.isin(model.geom_bodyid, model.geom_bodyid[robot.feet])
    feet &= bottoms_of(robot) < ground_of(robot) + 0.1 * robot.leg
    grounds = ground_planes(robot)
    if not grounds.any():
        grounds = (model.body_weldid[model.geom_bodyid] == 0) & touching_geoms(model)
    sides = [[model.geom(i).name for i in np.flatnonzero(these)] for these in (grounds, feet)]
    pairs = [[ground, foot] for ground in sides[0] for foot in sides[1]]
    return pairs if all(map(all, sides)) and len(pairs) <= MOST_CONTACTS else []


def stands_held(robot: Robot) -> bool:
    """Returns whether servos that hold the start keep a robot with legs up while DDP plans.

    Those are its own, or, if it has none, those that it shall get.
    """
    model, data = copy(robot.model), copy(robot.data)
    numbers = legged_numbers(robot)
    steps = round((numbers["horizon"] + numbers["lookahead"]) / model.opt.timestep)
    if model.nu:
        data.ctrl[:] = resting_controls(data)
        mujoco.mj_step(model, data, steps)
    else:
        places, dofs = model.jnt_qposadr[robot.joints], model.jnt_dofadr[robot.joints]
        limits, target = [motor_strength(robot, j) for j in robot.joints], data.qpos[places].copy()
        servos = [[*servo_numbers(robot, limit).values()] for limit in limits]
        stiffness, damping, armature = np.transpose(servos)
        model.dof_armature[dofs] += armature
        for _ in range(steps):
            torque = stiffness * (target - data.qpos[places]) - damping * data.qvel[dofs]
            data.qfrc_applied[dofs] = np.clip(torque, np.negative(limits), limits)
            mujoco.mj_step(model, data)
    fallen = data.xpos[robot.root, 2] - ground_of(robot) < FALLEN * robot.height
    return not (ground_planes(robot).any() and fallen)


def foot_terms(
    robot: Robot, numbers: dict[str, Any]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Returns the sensors of the feet by name, and the cost by which they swing in turn."""
    model, sensors, slips = robot.model, dict[str, Any](), list[dict[str, Any]]()
    steps, ground = list[dict[str, Any]](), ground_of(robot)
    for i, foot in enumerate(robot.feet):  # at the clock's rhythm
        name, geom = robot.new_sensor(f"foot_{i + 1}"), model.geom(foot).name
        rest, phase = robot.data.geom_xpos[foot, 2], 0.5 * (i % 2)  # its height while it is down
        sensors[name] = {"type": "framepos", "geom": geom}
        swing = {"swing": numbers["swing"], "phase": phase, "rest": rest}
        step = {"sensor": name, "index": "z", "target": swing, "weight": numbers["stepping"]}
        steps.append(step | ({"when": "moving"} if robot.hops else {}))
        # The middle of a whole shank moves while its end stands; what hops was not tried.
        if rest - ground > _LOW * robot.leg or robot.hops:
            continue
        speed, along = robot.new_sensor(f"foot_{i + 1}_speed"), robot.forward[0]
        sensors[speed] = {"type": "framelinvel", "geom": geom}
        slip = {"sensor": speed, "index": ["x", "y"] if robot.is_free else along}
        slips.append(slip | {"weight": numbers["slip"], "when": {"stance": phase}})
    stills = []
    for j in robot.joints if robot.hops else ():  # it stands as it starts
        place = f"{model.joint(j).name}/position"
        target = robot.data.qpos[model.jnt_qposadr[j]]
        stills.append({"sensor": place, "target": target, "weight": 5, "when": "still"})
    return sensors, [*steps, *slips, *stills]
