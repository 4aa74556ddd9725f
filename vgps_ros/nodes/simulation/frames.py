# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Publishes a robot's frames on `/tf` and `/tf_static`, as robot_state_publisher does."""

import math
import time

import mujoco
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from tf2_msgs.msg import TFMessage

from vgps_ros.core.records import Array
from vgps_ros.core.settings import Range, Setting
from vgps_ros.messages.conversions import stamp_of
from vgps_ros.ros_runtime.parameters import declare
from vgps_ros.ros_runtime.qos import LATEST, STATES, lively
from vgps_ros.simulation.frames import FIXED, Link, MovingLinks, links

TOPIC, FIXED_TOPIC = "/tf", "/tf_static"
TF_RATE = Setting(
    "tf_rate",
    30.0,
    Range(0.0, 10000.0),
    "states whose frames are published on /tf per second of the wall clock, at most; 0: "
    "no frames, for a robot_state_publisher that reads robot_description",
)


class FrameBroadcaster:
    """Publishes the frames of a node's robot, at most as often as the parameter `tf_rate` says.

    Attributes:
        topics: topics that no other node may publish for its robot; none where `tf_rate` is 0.
    """

    def __init__(self, node: Node, model: mujoco.MjModel):
        rate = declare(node, TF_RATE)
        self.topics = (TOPIC, FIXED_TOPIC) if rate else ()
        self._period = 1.0 / rate if rate else math.inf
        self._next = 0.0  # time of the next frames [s], by the steady clock
        if rate:
            self._transforms = _Transforms(model)
            self._moving = node.create_publisher(TFMessage, TOPIC, lively(STATES))
            self._fixed = node.create_publisher(TFMessage, FIXED_TOPIC, lively(LATEST))
            self._fixed.publish(self._transforms.fixed)

    def send(self, state: Array, stamp: int) -> None:
        """Publishes the frames of a state x of the time `stamp` [ns], if it is their turn."""
        now = time.monotonic()
        if not self.topics or now < self._next:
            return
        self._next = now + self._period
        self._moving.publish(self._transforms.at(state, stamp_of(stamp)))


class _Transforms:
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
        """Returns the transforms of a state that joints change; the next call changes them."""
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
