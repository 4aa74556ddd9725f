# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What an arm, a hand or a swimmer shall reach: the model's target, or a box for an arm's tip."""

from copy import copy
from itertools import product
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.wizard.robot import HINGE, Robot, free_object_joint, loops_of

_BOXES = (0.2, 0.15, 0.1, 0.05)  # half the width of a tip's box, of the arm's length
_NEAR = 5.0  # body lengths within which a swimmer is sent to a target


def set_box(robot: Robot) -> None:
    """Sets the box in which an arm's tip follows commands, and starts the arm in its middle.

    That is where the model starts or, as of a straight arm, where its joints are bent; they keep to
    the inner two thirds of their ranges, and no more touches. An arm that is for something else has
    no box, nor one whose own motors cannot bring the tip to all its corners.
    """
    model, data = robot.model, copy(robot.data)
    is_for_more = _find_target(robot) or free_object_joint(robot) is not None or loops_of(model)
    if robot.kind != "arm" or is_for_more or not robot.in_tree(model.geom_bodyid).any():
        return
    kind, name = next(iter(_tip(robot).items()))
    tip, links = getattr(data, kind)(name), robot.chain(getattr(model, kind)(name).bodyid[0])
    joints = [j for j in robot.joints if model.jnt_bodyid[j] in links]
    if not joints or not {*model.jnt_dofadr[joints].tolist()} <= robot.driven:
        return
    from scipy.optimize import least_squares  # which is slow to load

    points, at = [*data.xanchor[joints], tip.xpos], model.jnt_qposadr[joints]
    robot.reach = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    low, high = np.where(model.jnt_limited[joints, None], model.jnt_range[joints], [-9, 9]).T

    def way(positions: Array, place: Array | float) -> Array:
        """Returns the way from a place to the tip [m]."""
        data.qpos[at] = positions
        mujoco.mj_kinematics(model, data)
        return tip.xpos - place

    inner = np.quantile([low, high], [1 / 6, 5 / 6], axis=0)
    bends = (robot.goal - data.qpos)[at] * np.array([[0], [1], [-1], [2], [-2], [3], [-3]])
    poses = np.clip(data.qpos[at] + bends, *inner)
    moved = np.ptp([way(pose, 0.0) for pose in poses], axis=0) > 1e-6
    for share, pose in product(_BOXES, poses):
        half, middle = float(f"{share * robot.reach:.2g}"), way(pose, 0.0)
        mujoco.mj_forward(model, data)
        if data.ncon > robot.data.ncon:
            continue
        corners = [middle + half * moved * signs for signs in product((-1, 1), repeat=3)]
        fits = [least_squares(way, pose, bounds=(low, high), args=(c,)) for c in corners]
        if np.abs([fit.fun for fit in fits]).max() < 0.02 * robot.reach:
            robot.box = {"xyz"[i]: [middle[i], -half, half] for i in np.flatnonzero(moved)}
            data.qpos[at] = pose
            mujoco.mj_forward(model, data)
            robot.data, robot.goal, robot.strengths = data, data.qpos.copy(), robot.strengths or {}
            return


def target_values(robot: Robot) -> dict[str, Any]:
    """Returns the template's facts about what the robot shall reach."""
    reached, box = target_sensor(robot), robot.box
    return {
        "reached": reached,
        "ways": ([*box] or _motion_axes(robot)) if reached else [],
        "commanded": {axis: {"range": ends, "unit": "m"} for axis, (_, *ends) in box.items()},
        "places": [{"command": axis, "rest": middle} for axis, (middle, *_) in box.items()],
        "nearness": 16.0 / next(iter(box.values()))[2] ** 2 if box else 0.0,
    }


def has_target(robot: Robot) -> bool:
    """Returns whether the robot travels to the model's target, from wherever it is."""
    return bool(robot.base) and target_sensor(robot) is not None


def start_spread(robot: Robot) -> dict[str, Any]:
    """Returns the spread of starts from which a swimmer or an arm learns to reach its target."""
    if robot.box:
        slides = [robot.model.joint(j).name for j in robot.joints if j not in robot.hinges]
        still = {"overrides": {f"{name}/position": 0.01 for name in slides}} if slides else {}
        return {"position": 0.4, "velocity": 0.3} | still
    spread, half = dict[str, float](), target_distance(robot) / 2
    for name, kind in ((robot.model.joint(j).name, robot.model.jnt_type[j]) for j in robot.base):
        if robot.is_free:
            spread |= {f"{name}/[xyz]": half, f"{name}/r?": 1.0}
        else:
            spread[f"{name}/position"] = 1.0 if kind == HINGE else half
    return {"position": 0.2, "velocity": 0.1, "overrides": spread}


def target_sensor(robot: Robot) -> dict[str, Any] | None:
    """Returns the sensor of how far something is from the model's target, if it shall get there.

    That is an object beside an arm, or else its tip; and a swimmer, where the target is near. Of an
    arm that is commanded it is where its tip is.
    """
    if robot.box:
        return {"type": "framepos"} | _tip(robot)
    model, target, thing = robot.model, _find_target(robot), free_object_joint(robot)
    own = np.flatnonzero(robot.in_tree(model.geom_bodyid))
    if target is None or robot.kind not in ("arm", "hand", "swimmer") or not own.size:
        return None
    goal = {"relative_to": {target[0]: target[1]}}
    if robot.kind == "swimmer":
        size = np.ptp(robot.data.geom_xpos[own], axis=0).max() + model.geom_rbound[own].min()
        is_near = np.linalg.norm(target[2] - robot.data.xpos[robot.root]) < _NEAR * size
        seen = {"type": "framepos", target[0]: target[1], "relative_to": {"xbody": robot.name}}
        return seen if is_near else None  # in its own frame: where it has to turn
    if thing is None:
        return {"type": "framepos"} | _tip(robot) | goal
    is_turned, body = model.jnt_type[thing] == HINGE, model.body(model.jnt_bodyid[thing]).name
    return None if is_turned else {"type": "framepos", "xbody": body} | goal


def _find_target(robot: Robot) -> tuple[str, str, Array] | None:
    """Returns the first thing whose name says `target`: its kind, its name, and its place [m]."""
    model, data = robot.model, robot.data
    of_kinds = {"geom": model.geom_bodyid, "site": model.site_bodyid, "body": range(model.nbody)}
    for kind, bodies in of_kinds.items():
        for i, body in enumerate(bodies):
            thing = getattr(data, kind)(i)
            if "target" in thing.name and (kind == "site" or not robot.in_tree(body)):
                return "xbody" if kind == "body" else kind, thing.name, np.array(thing.xpos)
    return None


def _tip(robot: Robot) -> dict[str, str]:
    """Returns the point of the last link that is farthest from its start: a site, or its geom."""
    model, data = robot.model, robot.data
    geom = int(np.flatnonzero(robot.in_tree(model.geom_bodyid))[-1])
    body = model.geom_bodyid[geom]
    sites = np.flatnonzero(model.site_bodyid == body)
    ways = np.linalg.norm(data.site_xpos[sites] - data.xpos[body], axis=1)
    if ways.max(initial=0.0) > np.linalg.norm(data.geom_xpos[geom] - data.xpos[body]):
        return {"site": model.site(int(sites[ways.argmax()])).name}
    return {"geom": model.geom(geom).name}


def target_distance(robot: Robot) -> float:
    """Returns the distance from the robot to its target, or 1 without one [m]."""
    target = _find_target(robot)
    return float(np.linalg.norm(target[2] - robot.data.xpos[robot.root])) if target else 1.0


def carries_object(robot: Robot) -> bool:
    """Returns whether the robot brings a thing that falls to the target."""
    return (
        bool(robot.gravity)
        and target_sensor(robot) is not None
        and free_object_joint(robot) is not None
    )


def _motion_axes(robot: Robot) -> list[str]:
    """Returns the axes along which anything that joints carry can move, as all but y in a plane."""
    model, data = robot.model, mujoco.MjData(robot.model)
    rng, places = np.random.default_rng(0), []
    for _ in range(3):
        mujoco.mj_integratePos(model, data.qpos, rng.standard_normal(model.nv), 0.3)
        mujoco.mj_kinematics(model, data)
        places.append(data.geom_xpos[model.body_weldid[model.geom_bodyid] > 0].copy())
    return ["xyz"[i] for i in np.flatnonzero(np.ptp(places, axis=0).max(axis=0) > 1e-6)]
