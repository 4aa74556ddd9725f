# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Publishes the robot's MJCF and its URDF, for whoever draws, records or replays it."""

from rclpy.node import Node
from std_msgs.msg import String

from vgps_ros.messages.names import MJCF, URDF
from vgps_ros.ros_runtime.qos import LATEST
from vgps_ros.simulation.urdf import urdf
from vgps_ros.tasks import Task


def publish_mjcf(node: Node, task: Task) -> None:
    """Publishes the MJCF of the task's robot once; nodes that start later get it too."""
    node.create_publisher(String, MJCF, LATEST).publish(String(data=task.mjcf))


def publish_urdf(node: Node, task: Task) -> None:
    """Publishes the URDF of the task's robot likewise, which one node of a graph may do."""
    text = urdf(task.dynamics.model)
    node.create_publisher(String, URDF, LATEST).publish(String(data=text))
