# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The robot's MJCF on the topic `robot_description`, for whoever draws, records or replays it."""

from rclpy.node import Node
from std_msgs.msg import String

from vgps_ros.ros_runtime.qos import LATEST
from vgps_ros.tasks import Task


def publish_robot_description(node: Node, task: Task) -> None:
    """Publishes the MJCF of the task's robot once; nodes that start later get it too."""
    publisher = node.create_publisher(String, "robot_description", LATEST)
    publisher.publish(String(data=task.mjcf))
