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
        position = position + rotated(anchor - at + to_zero, rotation)
        rotation = product(rotation, turned_to_zero)
        yield Link(name, parent, joint, body if is_body else None, position, rotation)
        if is_body:
            return
        at, position, rotation, parent = anchor, _NOWHERE, _UPRIGHT, name
    yield Link(frames[body], parent, FIXED, body, position + rotated(-at, rotation), rotation)


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
                    positions[i] += rotated(state[place] * axis, rotations[i])
                case _JOINT.mjJNT_HINGE:
                    turn = np.empty(4)
                    mujoco.mju_axisAngle2Quat(turn, axis, state[place])
                case _JOINT.mjJNT_BALL:
                    turn = state[place : place + 4]
                case _JOINT.mjJNT_FREE:
                    positions[i], turn = np.split(state[place : place + 7], [3])
            rotations[i] = product(rotations[i], turn)
        return positions, rotations


def product(a: Array, b: Array) -> Array:
    """Returns the product of two quaternions (w, x, y, z)."""
    result = np.empty(4)
    mujoco.mju_mulQuat(result, a, b)
    return result


def rotated(vector: Array, quaternion: Array) -> Array:
    """Returns a vector, shape (3,), turned by a unit quaternion (w, x, y, z)."""
    result = np.empty(3)
    mujoco.mju_rotVecQuat(result, vector, quaternion)
    return result


def _unlike(name: str, others: list[str]) -> str:
    """Returns the name, with as many underscores after it as make it differ from all others."""
    while name in others:
        name += "_"
    return name
