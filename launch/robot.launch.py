# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Starts a simulated robot and the executor of its policy, in a namespace where one is given."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition
from launch.events import matches_action
from launch.substitutions import (
    LaunchConfiguration,
    NotEqualsSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import (
    LifecycleNode,
    Node,
    PushRosNamespace,
    SetParameter,
    SetParametersFromFile,
    SetRemap,
)
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition

FILE = PathJoinSubstitution([FindPackageShare("vgps_ros"), "config", "any_task.yaml"])


def given(argument: str) -> IfCondition:
    """Returns the condition that an argument is not empty."""
    return IfCondition(NotEqualsSubstitution(LaunchConfiguration(argument), ""))


def generate_launch_description() -> LaunchDescription:
    """Returns the nodes `simulation` and `policy_executor`, and what brings the latter up.

    The arguments hold for the nodes of a launch file that includes this one, too.
    """
    executor = LifecycleNode(
        package="vgps_ros",
        executable="policy_executor",
        name="policy_executor",
        namespace="",
        parameters=[{"autostart": False}],  # launch brings it up
    )

    def change(transition: int) -> EmitEvent:
        event = ChangeState(
            lifecycle_node_matcher=matches_action(executor), transition_id=transition
        )
        return EmitEvent(event=event)

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
                "params_file", default_value=FILE, description="parameter file of all nodes"
            ),
            PushRosNamespace(LaunchConfiguration("namespace")),
            *(
                SetRemap(f"/{topic}", topic, condition=given("namespace"))
                for topic in ("clock", "tf", "tf_static")
            ),
            SetParametersFromFile(LaunchConfiguration("params_file")),
            SetParameter("use_sim_time", LaunchConfiguration("use_sim_time")),
            SetParameter(
                "task",
                LaunchConfiguration("task"),
                condition=given("task"),
            ),
            Node(package="vgps_ros", executable="simulation"),
            RegisterEventHandler(
                OnStateTransition(
                    target_lifecycle_node=executor,
                    start_state="configuring",
                    goal_state="inactive",
                    entities=[change(Transition.TRANSITION_ACTIVATE)],
                )
            ),
            executor,
            change(Transition.TRANSITION_CONFIGURE),
        ]
    )
