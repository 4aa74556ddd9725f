# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Starts the executor of a robot's policy, and its simulation where there is no robot.

The executor moves nothing before somebody configures and activates it, but with autostart:=true.
"""

from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import (
    AndSubstitution,
    LaunchConfiguration,
    NotEqualsSubstitution,
    NotSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node, PushRosNamespace, SetParameter, SetParametersFromFile, SetRemap
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

FILE = PathJoinSubstitution([FindPackageShare("vgps_ros"), "config", "any_task.yaml"])


def given(argument: str) -> IfCondition:
    """Returns the condition that an argument is not empty."""
    return IfCondition(NotEqualsSubstitution(LaunchConfiguration(argument), ""))


def end_where_refused(event: Any, _: object) -> list[Shutdown]:
    """Ends the launch with a node that refuses its task or a parameter, but not with a killed one.

    What else the launch runs, such as a robot's driver, must outlive a crash.
    """
    return [Shutdown(reason=f"{event.process_name} refused to start")] * (event.returncode == 1)


def generate_launch_description() -> LaunchDescription:
    """Returns the node `policy_executor`, and `simulation`, or else `watchdog` for a real robot.

    The arguments hold for the nodes of a launch file that includes this one, too.
    """
    simulation, one = LaunchConfiguration("simulation"), LaunchConfiguration("one_process")
    autostart = ParameterValue(LaunchConfiguration("autostart"), value_type=bool)
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "namespace",
                default_value="",
                description="namespace of the nodes, clock and frames, as /robot1",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="follow the simulation's clock"
            ),
            DeclareLaunchArgument(
                "task",
                default_value="",
                description="task, by name or file; empty: the parameter file's, or swimmer",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=FILE,
                description="parameter file of all nodes; config/robot.yaml suits a real robot",
            ),
            DeclareLaunchArgument(
                "simulation",
                default_value="true",
                description="whether to simulate the robot; false: its own driver runs",
            ),
            DeclareLaunchArgument(
                "autostart",
                default_value="false",
                description="whether the executor configures and activates itself once, at start",
            ),
            DeclareLaunchArgument(
                "one_process",
                default_value="false",
                description="whether simulation and executor share a process, which is faster",
            ),
            PushRosNamespace(LaunchConfiguration("namespace")),
            *(
                SetRemap(f"/{topic}", topic, condition=given("namespace"))
                for topic in ("clock", "tf", "tf_static")
            ),
            SetParametersFromFile(LaunchConfiguration("params_file")),
            SetParameter("use_sim_time", LaunchConfiguration("use_sim_time")),
            Node(package="vgps_ros", executable="watchdog", condition=UnlessCondition(simulation)),
            SetParameter("task", LaunchConfiguration("task"), condition=given("task")),
            Node(
                package="vgps_ros",
                executable="simulation",
                condition=IfCondition(AndSubstitution(simulation, NotSubstitution(one))),
                on_exit=end_where_refused,
            ),
            Node(
                package="vgps_ros",
                executable="policy_executor",
                parameters=[{"autostart": autostart}],
                condition=UnlessCondition(AndSubstitution(simulation, one)),
                on_exit=end_where_refused,
            ),
            Node(
                package="vgps_ros",
                executable="node",
                arguments=["simulation", "policy_executor"],
                parameters=[{"autostart": autostart}],
                condition=IfCondition(AndSubstitution(simulation, one)),
                on_exit=end_where_refused,
            ),
        ]
    )
