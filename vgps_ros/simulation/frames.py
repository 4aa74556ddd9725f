# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A robot's frames as a tree of links, each on its parent by one joint, as URDF and tf have it.

MuJoCo moves a body by several joints, each about a point of the body. Between two links of URDF
there is one joint, which turns about the origin of the lower one. So a body with k joints becomes a
chain of links, of which the last one has the body's frame:

    parent ── joint 1 ──▶ link 1 ── ... ── joint k ──▶ link k ── (fixed, to the origin) ──▶ body

Link k is the body itself where joint k turns about the body's origin.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.robot.bodies import BACK, BodyJoint, PlanarBase, StateLayout, product, rotate
from vgps_ros.simulation.model import joint_names, joint_ranges, state_names

ROOT = "odom"  # of every robot, as REP-105 names the frame in which a robot starts
FIXED = -1
_JOINT = mujoco.mjtJoint
_NOWHERE, _UPRIGHT = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Link:
    """A frame, and the joint between it and its parent.

    Attributes:
        name: name of the frame.
        parent: name of the parent's frame.
        joint: index of the joint in MuJoCo's model, or `FIXED`.
        body: index of the body whose frame this is, or None for a link between two joints.
        position: of the frame in the parent's while the joint is at 0, shape (3,) [m].
        rotation: of the frame likewise, as a quaternion (w, x, y, z), shape (4,).
    """

    name: str
    parent: str
    joint: int
    body: int | None
    position: Array
    rotation: Array


def frame_names(model: mujoco.MjModel) -> list[str]:
    """Returns the name of each body's frame, of which the world's is `ROOT`; no two are equal.

    A body without a name takes that of its free joint.
    """
    names: list[str] = []
    for body in range(model.nbody):
        first = int(model.body_jntadr[body])
        of_joint = first >= 0 and model.jnt_type[first] == _JOINT.mjJNT_FREE
        own = model.body(body).name or (of_joint and model.joint(first).name) or f"body_{body}"
        names.append(_unlike(ROOT if body == 0 else own, names))
    return names


def links(model: mujoco.MjModel) -> list[Link]:
    """Returns all links but the root, each after its parent."""
    frames = frame_names(model)
    names = list(frames)
    return [link for body in range(1, model.nbody) for link in _chain(model, body, frames, names)]


def _chain(model: mujoco.MjModel, body: int, frames: list[str], names: list[str]) -> Iterator[Link]:
    """Yields the links from a body's parent to the body, and adds their names to those taken."""
    parent = frames[model.body_parentid[body]]
    # From the link before, whose origin is at the place `at` of the body, to the next one.
    at, position, rotation = _NOWHERE, model.body_pos[body], model.body_quat[body]
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    for joint in range(first, first + count):
        if is_free := model.jnt_type[joint] == _JOINT.mjJNT_FREE:
            position, rotation = _NOWHERE, _UPRIGHT
        anchor = _NOWHERE if is_free else model.jnt_pos[joint]
        is_body = joint == first + count - 1 and not anchor.any()
        name = frames[body]
        if not is_body:
            name = _unlike(f"{model.joint(joint).name or f'joint_{joint}'}_link", names)
            names.append(name)
        to_zero, turned_to_zero = _to_zero(model, joint)
        position = position + rotate(anchor - at + to_zero, rotation)
        rotation = product(rotation, turned_to_zero)
        yield Link(name, parent, joint, body if is_body else None, position, rotation)
        if is_body:
            return
        at, position, rotation, parent = anchor, _NOWHERE, _UPRIGHT, name
    yield Link(frames[body], parent, FIXED, body, position + rotate(-at, rotation), rotation)


def _to_zero(model: mujoco.MjModel, joint: int) -> tuple[Array, Array]:
    """Returns the motion of a hinge or slide from MuJoCo's initial position of it to 0."""
    kind, axis = _JOINT(model.jnt_type[joint]), model.jnt_axis[joint]
    initial = float(model.qpos0[model.jnt_qposadr[joint]])
    if kind == _JOINT.mjJNT_SLIDE:
        return -initial * axis, _UPRIGHT
    if kind == _JOINT.mjJNT_HINGE:
        turned = np.empty(4)
        mujoco.mju_axisAngle2Quat(turned, axis, -initial)
        return _NOWHERE, turned
    return _NOWHERE, _UPRIGHT


class MovingLinks:
    """The poses of the links that joints move, in their parents' frames, for any state.

    Attributes:
        links: the links, in the order of the poses.
    """

    def __init__(self, model: mujoco.MjModel):
        self.links = [link for link in links(model) if link.joint != FIXED]
        self._joints = [
            (_JOINT(model.jnt_type[i]), int(model.jnt_qposadr[i]), model.jnt_axis[i])
            for i in (link.joint for link in self.links)
        ]

    def poses(self, state: Array) -> tuple[Array, Array]:
        """Returns positions, shape (L, 3) [m], and quaternions (w, x, y, z), shape (L, 4).

        Args:
            state: x, or its positions qpos, shape (n_q,) at least.
        """
        positions = np.array([link.position for link in self.links]).reshape(-1, 3)
        rotations = np.array([link.rotation for link in self.links]).reshape(-1, 4)
        for i, (kind, place, axis) in enumerate(self._joints):
            turn = _UPRIGHT
            match kind:
                case _JOINT.mjJNT_SLIDE:
                    positions[i] += rotate(state[place] * axis, rotations[i])
                case _JOINT.mjJNT_HINGE:
                    turn = np.empty(4)
                    mujoco.mju_axisAngle2Quat(turn, axis, state[place])
                case _JOINT.mjJNT_BALL:
                    turn = state[place : place + 4]
                case _JOINT.mjJNT_FREE:
                    positions[i], turn = np.split(state[place : place + 7], [3])
            rotations[i] = product(rotations[i], turn)
        return positions, rotations


def state_layout(model: mujoco.MjModel) -> StateLayout:
    """Returns what the numbers of a model's state are."""
    bodies, frames = tuple(body_joints(model)), frame_names(model)
    free = [body for body in bodies if body.is_free]
    planar = None if free else _planar_base(model)
    base = free[0] if free else planar
    root = frames.index(base.name) if base else 0
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turns = {frames[i]: data.xquat[i] for i in range(model.nbody) if model.body_weldid[i] == root}
    for i in range(model.nsite):
        if model.body_weldid[model.site_bodyid[i]] == root and model.site(i).name:
            turn = np.empty(4)
            mujoco.mju_mat2Quat(turn, data.site_xmat[i])
            turns.setdefault(model.site(i).name, turn)
    back = data.xquat[root] * BACK
    return StateLayout(
        tuple(state_names(model)),
        tuple(joint_names(model)),
        joint_ranges(model),
        model.nq + model.nv,
        bodies,
        planar,
        model.body(min(1, model.nbody - 1)).name,
        tuple(turns),
        np.array([product(back, turn) for turn in turns.values()]),
    )


def body_joints(model: mujoco.MjModel) -> list[BodyJoint]:
    """Returns the free and ball joints; a free one is named as its body, as frames are."""
    found, frames = [], frame_names(model)
    for i in range(model.njnt):
        kind = _JOINT(model.jnt_type[i])
        is_free = kind == _JOINT.mjJNT_FREE
        if is_free or kind == _JOINT.mjJNT_BALL:
            frame, joint = frames[model.jnt_bodyid[i]], model.joint(i).name
            name = frame if is_free else (joint or frame)
            places = int(model.jnt_qposadr[i]), model.nq + int(model.jnt_dofadr[i])
            found.append(BodyJoint(name, is_free, *places))
    return found


def _planar_base(model: mujoco.MjModel) -> PlanarBase | None:
    """Returns the first body on the world with slides and then a hinge, without motors, if any."""
    driven = model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, 0]
    slide, hinge = int(_JOINT.mjJNT_SLIDE), int(_JOINT.mjJNT_HINGE)
    for body in np.flatnonzero(model.body_parentid[1:] == 0) + 1:
        first, count = model.body_jntadr[body], model.body_jntnum[body]
        joints = np.arange(first, first + count)
        kinds = model.jnt_type[joints].tolist()
        if kinds != [slide] * (count - 1) + [hinge] or count < 2 or np.isin(joints, driven).any():
            continue
        *slides, last = joints.tolist()
        return PlanarBase(
            frame_names(model)[body],
            tuple(model.joint(i).name for i in joints),
            tuple(model.jnt_qposadr[joints].tolist()),
            tuple((model.nq + model.jnt_dofadr[joints]).tolist()),
            model.qpos0[model.jnt_qposadr[joints]].copy(),
            model.body_pos[body].copy(),
            model.body_quat[body].copy(),
            model.jnt_axis[slides].T.copy(),
            model.jnt_axis[last].copy(),
            model.jnt_pos[last].copy(),
        )
    return None


def _unlike(name: str, others: list[str]) -> str:
    """Returns the name, with as many underscores after it as make it differ from all others."""
    while name in others:
        name += "_"
    return name
