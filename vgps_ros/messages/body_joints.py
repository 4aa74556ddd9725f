# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Free and ball joints in messages: a pose, and a twist in the body's own axes, as REP-105 has it.

MuJoCo has a free body's linear velocity in the world's axes, and a quaternion as w, x, y, z.
"""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.checks import finite_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.simulation.frames import frame_names, rotated

_UNIT_TOLERANCE = 1e-3  # of a quaternion's length: a driver may compute in single precision


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
        _put(orientation, "wxyz", rotation)
        _put(twist.angular, "xyz", angular)
        if self.is_free:
            _put(position, "xyz", at)
            _put(twist.linear, "xyz", rotated(linear, rotation * [1.0, -1.0, -1.0, -1.0]))

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


def _put(target: Any, names: str, values: Array) -> None:
    for name, value in zip(names, values.tolist(), strict=True):
        setattr(target, name, value)


def _get(what: str, source: Any, names: str) -> Array:
    return finite_array(what, [getattr(source, name) for name in names], (len(names),))
