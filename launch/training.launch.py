# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Starts all nodes that learn a policy and drive a simulated robot with it.

`vgps train-through-graph` then asks for a training.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Returns what robot.launch.py has, with its arguments, and the two nodes that learn."""
    robot = str(Path(__file__).with_name("robot.launch.py"))
    return LaunchDescription(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(robot), launch_arguments={"autostart": "true"}.items()
            ),
            Node(package="vgps_ros", executable="trajectory_optimizer"),
            Node(package="vgps_ros", executable="policy_learner"),
        ]
    )
