# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Plays a bag, and draws it into a Rerun recording where a file for that is named."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution, PathJoinSubstitution
from launch_ros.actions import Node, PushRosNamespace, SetParameter, SetParametersFromFile
from launch_ros.substitutions import FindPackageShare

FILE = PathJoinSubstitution([FindPackageShare("vgps_ros"), "config", "any_task.yaml"])


def given(argument: str) -> IfCondition:
    """Returns the condition that an argument is not empty."""
    return IfCondition(NotEqualsSubstitution(LaunchConfiguration(argument), ""))


def generate_launch_description() -> LaunchDescription:
    """Returns the nodes `visualizer` and `player`; all ends with the bag."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="folder of the bag"),
            DeclareLaunchArgument(
                "output",
                default_value="",
                description="Rerun recording to write, which must not exist; empty: none",
            ),
            DeclareLaunchArgument(
                "namespace",
                default_value="",
                description="namespace of both nodes, and of the robot that is drawn, as /robot1",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="follow the clock of the bag"
            ),
            DeclareLaunchArgument(
                "params_file", default_value=FILE, description="parameter file of both nodes"
            ),
            PushRosNamespace(LaunchConfiguration("namespace")),
            SetParametersFromFile(LaunchConfiguration("params_file")),
            SetParameter("use_sim_time", LaunchConfiguration("use_sim_time")),
            Node(
                package="vgps_ros",
                executable="visualizer",
                parameters=[{"output": LaunchConfiguration("output")}],
                condition=given("output"),
            ),
            Node(
                package="vgps_ros",
                executable="player",
                parameters=[{"bag": LaunchConfiguration("bag")}],
                on_exit=Shutdown(reason="The bag ends."),
            ),
        ]
    )
