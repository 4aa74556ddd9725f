# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Bodies that move freely in messages: a pose, and a twist in the body's own axes, as in REP-105.

MuJoCo has a free body's linear velocity in the world's axes, and a quaternion as w, x, y, z.

A model of a robot in the plane hangs on the world by slides and a hinge without motors. No encoder
measures them: a real robot has the pose and twist of its base as odometry, from which they follow.
"""

import math
from typing import Any

import numpy as np

from vgps_ros.core.bodies import BACK, BodyJoint, PlanarBase, product, rotated
from vgps_ros.core.checks import finite_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array

_UNIT_TOLERANCE = 1e-3  # of a quaternion's length: a driver may compute in single precision


def write_body(body: BodyJoint, x: Array, position: Any, orientation: Any, twist: Any) -> None:
    """Writes what x says of a body to the parts of a message; the twist is in the body's axes."""
    at, rotation, linear, angular = body.parts(x)
    put(orientation, "wxyz", rotation)
    put(twist.angular, "xyz", angular)
    if body.is_free:
        put(position, "xyz", at)
        put(twist.linear, "xyz", rotated(linear, rotation * BACK))


def read_body(
    body: BodyJoint, x: Array, topic: str, position: Any, orientation: Any, twist: Any
) -> None:
    """Writes what the parts of a message say of a body to x.

    Raises:
        InvalidInputError: a number is not finite, or the orientation is no unit quaternion.
    """
    at, rotation, linear, angular = body.parts(x)
    rotation[:] = _get(f"{topic}: orientation of {body.name}", orientation, "wxyz")
    if abs((length := float(np.linalg.norm(rotation))) - 1.0) > _UNIT_TOLERANCE:
        raise InvalidInputError(
            f"{topic}: orientation of {body.name} has the length {length:g}, but that of a "
            "quaternion must be 1."
        )
    angular[:] = _get(f"{topic}: angular velocity of {body.name}", twist.angular, "xyz")
    if body.is_free:
        at[:] = _get(f"{topic}: position of {body.name}", position, "xyz")
        along = _get(f"{topic}: linear velocity of {body.name}", twist.linear, "xyz")
        linear[:] = rotated(along, rotation)


def read_planar(
    base: PlanarBase, x: Array, topic: str, position: Any, orientation: Any, twist: Any
) -> None:
    """Writes what the parts of a message of odometry say of a planar base's joints to x.

    The hinge's angle is within half a turn of its initial one. What the joints cannot follow,
    such as a tilt out of the plane, is left out.

    Raises:
        InvalidInputError: a number is not finite, or the orientation is no unit quaternion.
    """
    free, moved = BodyJoint(base.name, True, 0, 7), np.empty(13)
    read_body(free, moved, topic, position, orientation, twist)
    at, rotation, linear, angular = free.parts(moved)
    to_world = base.rotation * BACK
    turned = product(to_world, rotation)
    angle = math.remainder(2.0 * math.atan2(base.axis @ turned[1:], turned[0]), 2.0 * math.pi)
    rate = base.axis @ angular
    arm = rotated(base.anchor, turned)  # from the body's origin to the anchor
    slid = rotated(at - base.position, to_world) + arm - base.anchor
    speed = rotated(linear, to_world) + rate * np.cross(base.axis, arm)
    along = np.linalg.pinv(base.axes)
    x[list(base.positions)] = base.initial + np.r_[along @ slid, angle]
    x[list(base.velocities)] = np.r_[along @ speed, rate]


def put(target: Any, names: str, values: Array) -> None:
    """Writes values to the fields of a message that the letters of a word name, such as xyz."""
    for name, value in zip(names, values.tolist(), strict=True):
        setattr(target, name, value)


def _get(what: str, source: Any, names: str) -> Array:
    return finite_array(what, [getattr(source, name) for name in names], (len(names),))
