# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Where a robot's state x = (qpos, qvel, act) holds its joints and its bodies; quaternions.

It takes no MuJoCo: a robot's executor knows its state by this alone. Quaternions are (w, x, y, z),
and the linear velocity of a free body is along the world's axes, both as in MuJoCo.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.checks import Shape
from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.records import Array

BACK = np.array([1.0, -1.0, -1.0, -1.0])  # times a unit quaternion: its inverse


def product(a: Array, b: Array) -> Array:
    """Returns the product of two quaternions."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a.tolist(), b.tolist()
    return np.array(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ]
    )


def rotate(vector: Array, quaternion: Array) -> Array:
    """Returns a vector, shape (3,), turned by a unit quaternion."""
    (x, y, z), (qw, qx, qy, qz) = vector.tolist(), quaternion.tolist()
    a = qw * x + qy * z - qz * y
    b = qw * y + qz * x - qx * z
    c = qw * z + qx * y - qy * x
    return np.array(
        [x + 2.0 * (qy * c - qz * b), y + 2.0 * (qz * a - qx * c), z + 2.0 * (qx * b - qy * a)]
    )


UP = np.array([0.0, 0.0, 1.0])  # in the world's axes


def vertical(quaternion: Array, up: Array = UP) -> Array:
    """Returns the vertical in the axes of bodies, shape (..., 3), by quaternions (..., 4).

    On sloping ground, to which the world's axes are fixed, it is `up` (3,) in these axes.
    """
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    ahead = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    left = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    above = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    axes = zip(ahead, left, above, strict=True)
    return np.stack([a * up[0] + b * up[1] + c * up[2] for a, b, c in axes], axis=-1)


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

    def parts(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Returns views of position, quaternion, linear and angular velocity in x (..., n_x)."""
        p, v, n = self.first_position, self.first_velocity, 3 * self.is_free
        return (
            x[..., p : p + n],
            x[..., p + n : p + n + 4],
            x[..., v : v + n],
            x[..., v + n : v + n + 3],
        )


@dataclass(frozen=True, eq=False)
class PlanarBase:
    """A body that slides along the world's axes, and then turns about one of them.

    Attributes:
        name: name of its frame.
        joints: names of its slides, and of its hinge; there are J.
        positions: where x holds their positions.
        velocities: where x holds their velocities.
        initial: their positions in which the body is at `position` and `rotation`, shape (J,).
        position: of the body in the world, shape (3,) [m].
        rotation: likewise, as a quaternion, shape (4,).
        axes: of the slides, in the body as it is at first, shape (3, J - 1).
        axis: of the hinge, shape (3,).
        anchor: of the hinge, in the body, shape (3,) [m].
    """

    name: str
    joints: tuple[str, ...]
    positions: tuple[int, ...]
    velocities: tuple[int, ...]
    initial: Annotated[Array, Shape("slides+1")]
    position: Annotated[Array, Shape("xyz")]
    rotation: Annotated[Array, Shape("wxyz")]
    axes: Annotated[Array, Shape("xyz", "slides")]
    axis: Annotated[Array, Shape("xyz")]
    anchor: Annotated[Array, Shape("xyz")]


@dataclass(frozen=True, eq=False)
class StateLayout:
    """What the numbers of x are.

    Attributes:
        names: of each number of x.
        joints: names of the hinges and slides, in the order of x.
        ranges: lowest and highest position of each joint, shape (2, J); infinite without a limit.
        first_activation: index of the first activation, behind all positions and velocities.
        bodies: free and ball joints.
        planar: what a planar robot hangs on the world by, if nothing is free.
        first_body: name of the frame of the first body.
        mounts: names of sites and bodies that are fixed to the base.
        turns: how each of them is turned in the base, as quaternions, shape (len(mounts), 4).
    """

    names: tuple[str, ...]
    joints: tuple[str, ...]
    ranges: Array
    first_activation: int
    bodies: tuple[BodyJoint, ...]
    planar: PlanarBase | None
    first_body: str
    mounts: tuple[str, ...]
    turns: Annotated[Array, Shape("mounts", "wxyz")]

    @cached_property
    def base(self) -> BodyJoint | None:
        """The free base, the first free joint, or None."""
        return next((body for body in self.bodies if body.is_free), None)

    @cached_property
    def base_frame(self) -> str:
        """Name of the base's frame; of a robot on a fixed base, its first body's."""
        base = self.base or self.planar
        return base.name if base else self.first_body

    @cached_property
    def space(self) -> StateSpace:
        """The space of the states."""
        firsts = (body.first_position + 3 * body.is_free for body in self.bodies)
        return StateSpace(len(self.names), tuple(sorted(firsts)))

    @cached_property
    def joint_places(self) -> NDArray[np.intp]:
        """Where x has the positions of all joints, and then their velocities."""
        return self.places(self.joints)

    def places(self, joints: tuple[str, ...]) -> NDArray[np.intp]:
        """Returns where x has the positions of joints, and then their velocities."""
        names = [f"{joint}/{kind}" for kind in ("position", "velocity") for joint in joints]
        return np.array([self.names.index(name) for name in names], dtype=np.intp)
