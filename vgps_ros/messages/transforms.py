# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A robot's frames as messages of tf, from its state."""

import mujoco
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from vgps_ros.core.records import Array
from vgps_ros.simulation.frames import FIXED, Link, MovingLinks, links


class Transforms:
    """Makes the messages of one robot.

    Attributes:
        fixed: the transforms that never change, for `/tf_static`.
    """

    def __init__(self, model: mujoco.MjModel):
        self._moving = MovingLinks(model)
        self._message = TFMessage(transforms=[_transform(link) for link in self._moving.links])
        self.fixed = TFMessage()
        for link in links(model):
            if link.joint == FIXED:
                transform = _transform(link)
                _set(transform, link.position.tolist(), link.rotation.tolist())
                self.fixed.transforms.append(transform)

    def at(self, state: Array, stamp: Time) -> TFMessage:
        """Returns the transforms that joints change, for `/tf`; the next call changes the message.

        Args:
            state: x, shape (n_x,).
            stamp: its time.
        """
        poses = (values.tolist() for values in self._moving.poses(state))
        for transform, *pose in zip(self._message.transforms, *poses, strict=True):
            transform.header.stamp = stamp
            _set(transform, *pose)
        return self._message


def _transform(link: Link) -> TransformStamped:
    transform = TransformStamped(child_frame_id=link.name)
    transform.header.frame_id = link.parent
    return transform


def _set(stamped: TransformStamped, position: list[float], rotation: list[float]) -> None:
    to, turned = stamped.transform.translation, stamped.transform.rotation
    to.x, to.y, to.z = position
    turned.w, turned.x, turned.y, turned.z = rotation
