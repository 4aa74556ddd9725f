# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds out what a robot is for, and where it starts, from its model alone.

That follows from its tree of bodies, its base, its mass and its actuators; names count only where
one says `target`.
"""

from functools import lru_cache

import mujoco
import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.wizard.robot import (
    FREE,
    HINGE,
    SLIDE,
    Robot,
    bending_joints,
    bottoms_of,
    finger_count,
    ground_of,
    held_joints,
    is_tied,
    is_weak,
    is_wheel,
    legs_of,
    loops_of,
)

_DENSE = 100.0  # density from which on a medium is a liquid [kg/m³]


@lru_cache(maxsize=2)  # of a model, which is the same only if it is one
def recognise_robot(model: mujoco.MjModel) -> Robot:
    """Returns the facts about a model; its kind decides how it starts, and what its goal is."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    driven = {int(i) for i in data.moment_colind[: int(data.moment_rownnz.sum())]}
    single = {int(i) for i in model.jnt_dofadr[model.jnt_type >= SLIDE]}
    trees = model.dof_treeid[[*(driven or single)]]
    if not (trees >= 0).any():
        raise InvalidInputError(
            "--model: no actuator drives a joint, and there is no hinge or slide that a motor "
            "could drive; name a model of a robot."
        )
    tree = int(np.bincount(trees[trees >= 0]).argmax())
    root = int(np.flatnonzero(model.body_treeid == tree)[0])
    first = [int(j) for j in model.body_jntadr[root] + np.arange(model.body_jntnum[root])]
    held = held_joints(model)
    base = [j for j in first if model.jnt_dofadr[j] not in driven and not held[j]]
    free = any(model.jnt_type[j] == FREE for j in base)
    slides = any(model.jnt_type[j] == SLIDE for j in base) and (model.nu or len(first) > 1)
    base = base if free or slides else []
    flags = model.opt.disableflags
    gravity = 0.0 if flags & mujoco.mjtDisableBit.mjDSBL_GRAVITY else abs(model.opt.gravity[2])
    trees = [tree] if base or not driven else trees[trees >= 0].tolist()
    for ends in loops_of(model):  # what a loop ties to it is a part of it
        tied = [int(model.body_treeid[end]) for end in ends]
        trees += [i for i in tied if i >= 0] if {*tied} & {*trees} else []
    robot = Robot(model, data, root, trees, base, driven or single, float(gravity))
    if not model.nu and not robot.joints:
        raise InvalidInputError(
            "--model: nothing but its base moves, and no actuator drives that; name a model with "
            "links and motors. Where a program adds them, save the MJCF that it makes."
        )
    ups = [round(robot.reset(key).frame[2, 2], 1) for key in range(model.nkey)]
    key = int(np.argmax(ups)) if ups else None
    robot.reset(None if key is None or np.allclose(model.key_qpos[key], model.qpos0) else key)
    if not base:
        _keep_limits(robot)
    if base and (model.opt.density > _DENSE or model.opt.viscosity > 1e-3):
        robot.kind = "swimmer"
    elif base:
        robot.kind = "vehicle"
        if robot.gravity and _height_index(robot) is not None:
            _stand_on_ground(robot)
        if robot.key is not None and (not robot.feet or _is_crouching(robot)):
            stands = robot.reset(None).frame[2, 2] > 0.9
            if stands:
                _stand_on_ground(robot)
            if not (stands and robot.feet):
                _stand_on_ground(robot.reset(key))
    elif robot.gravity and any(_is_moved_by_gravity(robot, j) for j in robot.joints):
        robot.kind = "pendulum"
    elif finger_count(robot) > 2:
        robot.kind = "hand"
    _set_forward(robot)
    _set_goal(robot)
    return robot


def _is_moved_by_gravity(robot: Robot, joint: int) -> bool:
    """Returns whether gravity moves a hinge: there is no motor, spring or loop, or it is weak."""
    model = robot.model
    if model.jnt_type[joint] != HINGE:
        return False
    if model.jnt_dofadr[joint] in robot.driven:
        return is_weak(robot, joint)
    return not np.any(model.jnt_stiffness[joint]) and not is_tied(robot, joint)


def _height_index(robot: Robot) -> int | None:
    """Returns the place in qpos of the base's height."""
    model = robot.model
    for j in robot.base:
        is_free = model.jnt_type[j] == FREE
        if is_free or (model.jnt_type[j] == SLIDE and abs(robot.data.xaxis[j][2]) > 0.5):
            return int(model.jnt_qposadr[j] + 2 * is_free)
    return None


def _stand_on_ground(robot: Robot) -> None:
    """Sets the start of a robot that gravity holds on the ground: within its limits, knees bent.

    Its feet are what of its outermost bodies is lowest.
    """
    model, data = robot.model, robot.data
    original = data.qpos.copy()
    _keep_limits(robot)
    robot.feet = _find_feet(robot)
    if robot.feet:
        _bend_knees(robot, original)
        robot.feet = _find_feet(robot)
    lowest = float(bottoms_of(robot).min(initial=np.inf))
    if np.isfinite(lowest):
        depth, height = ground_of(robot) - lowest, data.xpos[robot.root][2] - lowest
        hovers = robot.feet and 0.04 < -depth / height < 2.0
        data.qpos[_height_index(robot)] += depth if depth > 0.004 * height or hovers else 0.0
    mujoco.mj_forward(model, data)
    robot.height = float(data.xpos[robot.root][2] - ground_of(robot))
    if robot.feet:
        robot.kind = "legs"


def _keep_limits(robot: Robot) -> None:
    """Sets joints that start beyond their limits to a quarter of their range inside them."""
    model, data = robot.model, robot.data
    for j in robot.joints:
        place, (low, high) = model.jnt_qposadr[j], model.jnt_range[j]
        if model.jnt_limited[j] and not low - 1e-6 <= data.qpos[place] <= high + 1e-6:
            share = 0.25 * (high - low)
            data.qpos[place] = np.clip(data.qpos[place], low + share, high - share)
    mujoco.mj_forward(model, data)


def _is_crouching(robot: Robot) -> bool:
    """Returns whether its hips are lower than half the length of its legs."""
    for foot, leg in zip(robot.feet, legs_of(robot), strict=True):
        bending = bending_joints(robot, leg)
        points = [*robot.data.xanchor[bending], robot.data.geom_xpos[foot]]
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        if points[0][2] - ground_of(robot) < 0.5 * length:
            return True
    return False


def _find_feet(robot: Robot) -> list[int]:
    """Returns a geom of each foot, by the angle around the robot, the left front one first."""
    model, data = robot.model, robot.data
    bottoms = bottoms_of(robot)
    bodies = np.unique(model.geom_bodyid[np.isfinite(bottoms)])
    lowest = float(bottoms.min(initial=np.inf))
    height = data.xpos[robot.root][2] - lowest
    reach = lowest + 0.1 * height if bodies.size else lowest  # a robot may have no shapes
    found = dict[int, int]()
    for body in map(int, np.setdiff1d(bodies, [*model.body_parentid[bodies], robot.root])):
        own = np.flatnonzero((model.geom_bodyid == body) & np.isfinite(bottoms))
        if bottoms[own].min() < reach and not is_wheel(robot, body, own):
            soles = own[bottoms[own] < bottoms[own].min() + 0.02 * height]
            places = data.geom_xpos[soles]
            nearest = np.abs(places - places.mean(axis=0)).sum(axis=1).argmin()
            found[int(model.body_parentid[body])] = int(soles[nearest])
    for geom in list(found.values()):  # what is above a foot on the same leg is none
        for parent in robot.chain(int(model.geom_bodyid[geom]))[1:]:
            if parent in found and bottoms[found[parent]] > bottoms[geom] + 0.04 * height:
                del found[parent]
    centre = data.subtree_com[robot.root] if robot.base else data.xpos[robot.root]
    around = {i: np.arctan2(*(data.geom_xpos[i] - centre)[[1, 0]]) for i in found.values()}
    return sorted(around, key=lambda i: around[i] % (2 * np.pi))


def _bend_knees(robot: Robot, original: Array) -> None:
    """Bends legs that are straight, or whose joints were beyond their ranges in the model's pose.

    Each foot comes to below where it was there, or at least near it, nearer to the trunk and as
    level, by damped Gauss-Newton steps over the joints of its leg. One that does not stays.
    """
    model, data = robot.model, robot.data
    inside = data.qpos.copy()
    data.qpos[:] = original
    mujoco.mj_kinematics(model, data)
    places, frames = data.geom_xpos.copy(), data.geom_xmat.reshape(-1, 3, 3).copy()
    data.qpos[:] = inside
    middle, spread = places[robot.feet].mean(axis=0), np.ptp(places[robot.feet], axis=0)
    # Pushes to the side are what four legs in a narrow stance do not bear.
    is_narrow = len(robot.feet) > 2 and spread[:2].min() < data.xpos[robot.root][2] - middle[2]
    wider = 0.15 * (spread[:2] == spread[:2].min()) * is_narrow
    for foot, hinges in zip(robot.feet, legs_of(robot), strict=True):
        wanted, level = places[foot], frames[foot]
        mujoco.mj_kinematics(model, data)
        leg = bending_joints(robot, hinges)
        points = [*data.xanchor[leg], *([] if len(leg) > 2 else [data.geom_xpos[foot]])]
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum() if len(leg) > 1 else 0.0
        at, dofs = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]
        low, high = np.where(
            model.jnt_limited[hinges, None], model.jnt_range[hinges], [-3.0, 3.0]
        ).T
        moved, before = inside[at] != original[at], data.qpos[at].copy()
        is_straight = length and np.linalg.norm(points[-1] - points[0]) > 0.97 * length
        if not (length and (is_straight or moved.any())):
            continue
        wanted[2] += (0.36 if len(robot.feet) > 2 else 0.07) * length
        wanted[:2] += wider * np.sign(wanted[:2] - middle[:2]) * length
        # A straight knee bends either way; it begins on the side where its range is larger.
        way = 0.3 * np.sign(low + high - 2 * before)
        bent = before + np.where(np.isin(hinges, leg[1:2]) & ~moved, way, 0.0)
        weight = 0.3 * length * (len(leg) > 2)  # only an ankle keeps a foot level
        jacobian, turning = np.zeros((2, 3, model.nv))
        for aside in (1.0, 0.3):  # how much it counts to be right below
            near = np.array([aside, aside, 1.0])
            data.qpos[at] = bent
            for _ in range(100):
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_jacGeom(model, data, jacobian, turning, foot)
                turn = 0.5 * np.cross(data.geom_xmat[foot].reshape(3, 3).T, level.T).sum(axis=0)
                error = np.r_[near * (wanted - data.geom_xpos[foot]), weight * turn]
                rows = np.concatenate([near[:, None] * jacobian, weight * turning])[:, dofs]
                for _ in range(2):  # again without the joints that it drives against their limits
                    square = rows.T @ rows + 1e-3 * length**2 * np.eye(len(dofs))
                    step = np.linalg.solve(square, rows.T @ error)
                    now = data.qpos[at]
                    rows *= ((now > low) | (step > 0)) & ((now < high) | (step < 0))
                data.qpos[at] = np.clip(now + step, low, high)
            if np.abs(error[:3]).max() < 0.05 * length:
                break
        else:
            data.qpos[at] = before
    mujoco.mj_kinematics(model, data)


def _set_forward(robot: Robot) -> None:
    """Sets the direction in which a robot goes: that of a swimmer's head, or across its sides.

    One whose feet hardly move in that direction goes in the other.
    """
    model, data = robot.model, robot.data
    bodies = np.flatnonzero(robot.in_tree(np.arange(model.nbody)))
    if robot.kind == "swimmer":
        behind = data.subtree_com[robot.root] - data.xipos[robot.root]
        if np.abs(behind[:2]).max() > 1e-3:
            axis = int(np.abs(behind[:2]).argmax())
            robot.forward = ("xy"[axis], -float(np.sign(behind[axis])))
    elif robot.is_free:
        # In the root's frame, as its velocities are:
        local = (data.xpos[bodies] - data.xpos[robot.root]) @ robot.frame
        images = [local * [-1.0, 1.0, 1.0], local * [1.0, -1.0, 1.0]]
        gaps = (np.abs(image[:, None] - local).sum(axis=2) for image in images)
        unlike = [each.min(axis=1).sum() for each in gaps]
        along, across = _foot_reach(robot)[:2]
        if unlike[0] < 0.1 * unlike[1] or along < 0.1 * across:
            robot.forward = ("y", 1.0)


def _foot_reach(robot: Robot) -> Array:
    """Returns how far hinges move the feet along each of the root's axes [m/rad], shape (3,)."""
    model, found, jacobian = robot.model, np.zeros(3), np.empty((3, robot.model.nv))
    for foot, leg in zip(robot.feet, legs_of(robot), strict=True):
        mujoco.mj_jacGeom(model, robot.data, jacobian, None, foot)
        found += np.abs(robot.frame.T @ jacobian[:, model.jnt_dofadr[leg]]).sum(axis=1)
    return found


def _set_goal(robot: Robot) -> None:
    """Sets the positions that a robot which stays in its place shall come to.

    A pendulum starts where it hangs lowest and shall stand highest: hinges are tried in turn, in
    steps of an eighth of a turn. Another one shall move its joints by up to half a radian.
    """
    model, data = robot.model, robot.data
    robot.goal = np.array(data.qpos)
    if robot.base:
        return
    if robot.kind != "pendulum":
        for j in robot.joints:
            place, (low, high) = model.jnt_qposadr[j], model.jnt_range[j]
            at, way = data.qpos[place], 0.5 if model.jnt_type[j] == HINGE else 0.1
            if model.jnt_limited[j]:  # towards the middle, or away from it
                inwards = (low + high) / 2 - at
                away = min(way, (high - low) / 4)
                way = np.clip(inwards, -way, way) if abs(inwards) > 0.05 else away
            robot.goal[place] = at + way * (model.jnt_dofadr[j] in robot.driven)
        return
    wide = ~model.jnt_limited.astype(bool) | (np.ptp(model.jnt_range, axis=1) > 6.0)
    turning = [j for j in robot.hinges if wide[j]]
    robot.goal, lowest = (_extreme_pose(robot, turning, sign) for sign in (1.0, -1.0))
    if np.allclose(robot.goal, lowest):  # as of a pole that its limits hold up
        lowest[model.jnt_qposadr[[j for j in robot.joints if _is_moved_by_gravity(robot, j)]]] += (
            0.1
        )
    data.qpos[:], robot.key = lowest, None
    mujoco.mj_forward(model, data)


def _extreme_pose(robot: Robot, joints: list[int], sign: float) -> Array:
    """Returns the positions at which ± the energy of a pendulum is greatest."""
    model, data = robot.model, robot.data

    def energy(qpos: Array) -> float:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        return round(sign * float(data.energy[0]), 9)

    best = np.array(data.qpos)
    for place in 2 * model.jnt_qposadr[joints].tolist():
        tried = np.tile(best, (8, 1))
        tried[:, place] = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
        best = max(tried, key=energy)
    return best
