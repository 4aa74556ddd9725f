# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Drives a robot along a course, by publishing velocities on cmd_vel.

A course is figure_of_eight, or a YAML file that lists legs, in s, m/s and rad/s, in the robot's
axes: - {duration: 6.0, linear: {x: 0.4}, angular: {z: 0.5}}. What a leg leaves out is zero.
Nothing measures the robot's place, so errors of its velocities add up along the path. At the end,
and where INT or TERM comes, all velocities are zero. Any robot that takes cmd_vel can be driven.
Time is that of the node: with --ros-args -p use_sim_time:=true, that of /clock.
"""

import argparse
import time

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.settings import Range, Setting
from vgps_ros.programs.command_line import Parser
from vgps_ros.tasks.course import FIGURE_OF_EIGHT, SPEED, TURN, course_of

RATE = Setting("rate", 20.0, Range(0.1, 1000.0), "commands per second [Hz]")
_FAREWELL = 1.0  # longest wait until the last command has arrived [s]


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    course = f"{FIGURE_OF_EIGHT}, or a file of legs"
    parser.add_argument("course", nargs="?", default=FIGURE_OF_EIGHT, help=course)
    parser.add_settings(SPEED, TURN, RATE)
    parser.add_argument(
        "--unstamped",
        action="store_true",
        help="publish geometry_msgs/Twist in place of TwistStamped, as older robots take it",
    )
    parser.add_ros_arguments("a robot that takes cmd_vel")


def run(arguments: argparse.Namespace) -> None:
    """Drives the course that the arguments name."""
    course = course_of(arguments.course, arguments.speed, arguments.turn)
    import numpy as np
    from geometry_msgs.msg import Twist, TwistStamped
    from rclpy.duration import Duration
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    from vgps_ros.messages.conversions import twist_to_msg
    from vgps_ros.messages.names import CMD_VEL
    from vgps_ros.ros_runtime.runner import client_node, spin_once

    with client_node(lambda: Node("drive", namespace=arguments.namespace)) as node:
        kind = Twist if arguments.unstamped else TwistStamped
        publisher = node.create_publisher(kind, CMD_VEL, 10)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        end = time.monotonic() + arguments.timeout
        while not publisher.get_subscription_count():
            if time.monotonic() > end:
                raise VgpsError(
                    f"Waited {arguments.timeout:g} s, but nobody takes {publisher.topic_name} as "
                    f"{kind.__name__}; start a controller of a task with commands, or name the "
                    "robot's topic by --ros-args -r cmd_vel:=TOPIC."
                )
            spin_once(executor, 0.1)
        begin = passed = 0.0

        def publish(velocities: "np.ndarray") -> None:
            message = twist_to_msg(velocities, node.get_clock().now().to_msg())
            publisher.publish(message.twist if arguments.unstamped else message)

        def command() -> None:
            nonlocal begin, passed
            now = node.get_clock().now().nanoseconds * 1e-9
            if not begin or now < begin:  # the first time, or simulated time that was reset
                begin = now
            passed = now - begin
            publish(course.at(passed))

        node.create_timer(1.0 / arguments.rate, command)
        print(f"Driving {arguments.course} for {course.duration:.1f} s.", flush=True)
        try:
            while passed < course.duration:
                spin_once(executor, 0.1)
        finally:
            publish(np.zeros(6))
            publisher.wait_for_all_acked(Duration(seconds=_FAREWELL))
    print("The course is driven, and the robot is commanded to rest.")
