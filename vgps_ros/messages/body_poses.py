# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Bodies that move freely in messages: a pose, and a twist in the body's own axes, as in REP-105.

MuJoCo has a free body's linear velocity in the world's axes, and a quaternion as w, x, y, z.

A model of a robot in the plane hangs on the world by slides and a hinge without motors. No encoder
measures them: a real robot has the pose and twist of its base as odometry, from which they follow.
"""

import math
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.checks import finite_array, quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.simulation.frames import frame_names, product, rotated

_UNIT_TOLERANCE = 1e-3  # of a quaternion's length: a driver may compute in single precision
_SLIDE, _HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
BACK = np.array([1.0, -1.0, -1.0, -1.0])  # times a unit quaternion: its inverse


@dataclass(frozen=True)
class BodyJoint:
    """A free or ball joint, and where x holds it; a ball has no position of its own.

    Attributes:
        name: the joint's name, and the child frame's.
        is_free: whether it is a free joint.
        first_position: index of its first number among the positions.
        first_velocity: index of its first number among the velocities.
    """

    name: str
    is_free: bool
    first_position: int
    first_velocity: int

    def write(self, x: Array, position: Any, orientation: Any, twist: Any) -> None:
        """Writes what x says to the parts of a message; the twist is in the body's axes."""
        at, rotation, linear, angular = self.parts(x)
        put(orientation, "wxyz", rotation)
        put(twist.angular, "xyz", angular)
        if self.is_free:
            put(position, "xyz", at)
            put(twist.linear, "xyz", rotated(linear, rotation * BACK))

    def read(self, x: Array, topic: str, position: Any, orientation: Any, twist: Any) -> None:
        """Writes what the parts of a message say to x.

        Raises:
            InvalidInputError: a number is not finite, or the orientation is no unit quaternion.
        """
        at, rotation, linear, angular = self.parts(x)
        rotation[:] = _get(f"{topic}: orientation of {self.name}", orientation, "wxyz")
        if abs((length := float(np.linalg.norm(rotation))) - 1.0) > _UNIT_TOLERANCE:
            raise InvalidInputError(
                f"{topic}: orientation of {self.name} has the length {length:g}, but that of a "
                "quaternion must be 1."
            )
        angular[:] = _get(f"{topic}: angular velocity of {self.name}", twist.angular, "xyz")
        if self.is_free:
            at[:] = _get(f"{topic}: position of {self.name}", position, "xyz")
            along = _get(f"{topic}: linear velocity of {self.name}", twist.linear, "xyz")
            linear[:] = rotated(along, rotation)

    def parts(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Returns views of position, quaternion, linear and angular velocity in x."""
        p, v, n = self.first_position, self.first_velocity, 3 * self.is_free
        return x[p : p + n], x[p + n : p + n + 4], x[v : v + n], x[v + n : v + n + 3]


def body_joints(model: mujoco.MjModel) -> list[BodyJoint]:
    """Returns the free and ball joints; a free one is named as its body, as frames are."""
    found, frames = [], frame_names(model)
    for i in range(model.njnt):
        kind = mujoco.mjtJoint(model.jnt_type[i])
        is_free = kind == mujoco.mjtJoint.mjJNT_FREE
        if is_free or kind == mujoco.mjtJoint.mjJNT_BALL:
            frame, joint = frames[model.jnt_bodyid[i]], model.joint(i).name
            name = frame if is_free else (joint or frame)
            places = int(model.jnt_qposadr[i]), model.nq + int(model.jnt_dofadr[i])
            found.append(BodyJoint(name, is_free, *places))
    return found


@dataclass(frozen=True)
class PlanarBase:
    """A body that slides along the world's axes, and then turns about one of them.

    Attributes:
        name: name of its frame.
        joints: names of its slides, and of its hinge.
        places: where x holds their positions and their velocities, shape (2, J).
        initial: their positions in which the body is at `position` and `rotation`, shape (J,).
        position: of the body in the world, shape (3,) [m].
        rotation: likewise, as a quaternion (w, x, y, z), shape (4,).
        axes: of the slides, in the body as it is at first, shape (3, J - 1).
        axis: of the hinge, shape (3,).
        anchor: of the hinge, in the body, shape (3,) [m].
    """

    name: str
    joints: tuple[str, ...]
    places: Array
    initial: Array
    position: Array
    rotation: Array
    axes: Array
    axis: Array
    anchor: Array

    def read(self, x: Array, topic: str, position: Any, orientation: Any, twist: Any) -> None:
        """Writes what the parts of a message of odometry say of the joints to x.

        The hinge's angle is within half a turn of its initial one. What the joints cannot follow,
        such as a tilt out of the plane, is left out.

        Raises:
            InvalidInputError: a number is not finite, or the orientation is no unit quaternion.
        """
        free, moved = BodyJoint(self.name, True, 0, 7), np.empty(13)
        free.read(moved, topic, position, orientation, twist)
        at, rotation, linear, angular = free.parts(moved)
        to_world = self.rotation * BACK
        turned = product(to_world, rotation)
        angle = math.remainder(2.0 * math.atan2(self.axis @ turned[1:], turned[0]), 2.0 * math.pi)
        rate = self.axis @ angular
        arm = rotated(self.anchor, turned)  # from the body's origin to the anchor
        slid = rotated(at - self.position, to_world) + arm - self.anchor
        speed = rotated(linear, to_world) + rate * np.cross(self.axis, arm)
        along = np.linalg.pinv(self.axes)
        x[self.places[0]] = self.initial + np.r_[along @ slid, angle]
        x[self.places[1]] = np.r_[along @ speed, rate]


def planar_base(model: mujoco.MjModel) -> PlanarBase | None:
    """Returns the first body on the world with slides and then a hinge, without motors, if any."""
    driven = model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, 0]
    for body in np.flatnonzero(model.body_parentid[1:] == 0) + 1:
        first, count = model.body_jntadr[body], model.body_jntnum[body]
        joints = np.arange(first, first + count)
        kinds = model.jnt_type[joints].tolist()
        if kinds != [_SLIDE] * (count - 1) + [_HINGE] or count < 2 or np.isin(joints, driven).any():
            continue
        *slides, hinge = joints.tolist()
        places = model.jnt_qposadr[joints], model.nq + model.jnt_dofadr[joints]
        return PlanarBase(
            frame_names(model)[body],
            tuple(model.joint(i).name for i in joints),
            np.array(places, dtype=np.intp),
            model.qpos0[model.jnt_qposadr[joints]].copy(),
            model.body_pos[body].copy(),
            model.body_quat[body].copy(),
            model.jnt_axis[slides].T.copy(),
            model.jnt_axis[hinge].copy(),
            model.jnt_pos[hinge].copy(),
        )
    return None


def turn_on_base(
    model: mujoco.MjModel, base_frame: str, base: BodyJoint | PlanarBase | None, frame: str
) -> Array:
    """Returns how a site or body that is fixed to the base is turned in it, as a quaternion (4,).

    It has no turn if its name is empty or that of the base's frame in messages.

    Raises:
        InvalidInputError: there is no such site or body, or it moves in the base.
    """
    if frame in ("", base_frame):
        return np.array([1.0, 0.0, 0.0, 0.0])
    frames = frame_names(model)
    root = frames.index(base.name) if base else 0
    bodies = dict(zip(frames, range(model.nbody), strict=True))
    sites = {model.site(i).name: i for i in range(model.nsite)}
    fixed = [name for name, i in bodies.items() if model.body_weldid[i] == root]
    fixed += [name for name, i in sites.items() if model.body_weldid[model.site_bodyid[i]] == root]
    if frame not in fixed:
        raise InvalidInputError(
            f"The frame of imu is {quoted(frame)}, but it must be that of the robot's base, "
            f"'{base_frame}', or of what is fixed to it, {', '.join(filter(None, fixed))}; set "
            "imu_frame to the one at which the IMU sits."
        )
    data, turn = mujoco.MjData(model), np.empty(4)
    mujoco.mj_kinematics(model, data)
    if frame in bodies:
        turn[:] = data.xquat[bodies[frame]]
    else:
        mujoco.mju_mat2Quat(turn, data.site_xmat[sites[frame]])
    return product(data.xquat[root] * BACK, turn)


def put(target: Any, names: str, values: Array) -> None:
    """Writes values to the fields of a message that the letters of a word name, such as xyz."""
    for name, value in zip(names, values.tolist(), strict=True):
        setattr(target, name, value)


def _get(what: str, source: Any, names: str) -> Array:
    return finite_array(what, [getattr(source, name) for name in names], (len(names),))
