# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `drive`: a course by cmd_vel, whoever takes it, and rest at its end."""

import pytest
from geometry_msgs.msg import Twist, TwistStamped
from rosgraph_msgs.msg import Clock

from tests.nodes.conftest import EACH_SIGNAL
from vgps_ros.messages.conversions import stamp_of

COURSE = """\
- {duration: 0.5, linear: {x: 0.4}, angular: {z: 0.5}}
- {duration: 0.5, linear: {y: -0.2}}
"""


@pytest.fixture
def course(tmp_path):
    (tmp_path / "course.yaml").write_text(COURSE)
    return str(tmp_path / "course.yaml")


def told(twists):
    """What was commanded, each of several alike messages once."""
    values = [(t.linear.x, t.linear.y, t.angular.z) for t in twists]
    return [v for i, v in enumerate(values) if i == 0 or v != values[i - 1]]


LEGS = [(0.4, 0.0, 0.5), (0.0, -0.2, 0.0), (0.0, 0.0, 0.0)]


def test_it_drives_the_legs_and_ends_at_rest(graph, course):
    twists = graph.messages(TwistStamped, "cmd_vel")
    program = graph.start("drive", course, "--rate", "50")
    graph.ends(program)
    assert told(message.twist for message in twists) == LEGS
    assert twists[0].header.stamp.sec
    assert "commanded to rest" in program.output


def test_unstamped_velocities_come_on_any_topic(graph, course):
    twists = graph.messages(Twist, "robot/cmd")
    arguments = ("--unstamped", "--ros-args", "-r", "cmd_vel:=robot/cmd")
    program = graph.start("drive", course, *arguments)
    graph.ends(program)
    assert told(twists) == LEGS


@EACH_SIGNAL
def test_a_signal_ends_it_with_the_robot_at_rest(graph, number):
    twists = graph.messages(TwistStamped, "cmd_vel")
    program = graph.start("drive")
    graph.spin_until(lambda: any(message.twist.linear.x for message in twists), what="its driving")
    assert program.end(number) == 1
    assert "vgps drive: interrupted." in program.output
    assert "Traceback" not in program.output
    graph.spin_until(lambda: told(message.twist for message in twists)[-1] == LEGS[-1])


def test_simulated_time_drives_it_and_a_reset_begins_the_course_again(graph, course):
    twists = graph.messages(TwistStamped, "cmd_vel")
    clock = graph.node.create_publisher(Clock, "/clock", 10)
    program = graph.start("drive", course, "--ros-args", "-p", "use_sim_time:=true")
    graph.spin_until_output(program, "Driving")

    def newest_at(time, leg):
        twists.clear()

        def is_told():
            nonlocal time
            time += 0.01
            clock.publish(Clock(clock=stamp_of(round(time * 1e9))))
            return twists and told(message.twist for message in twists)[-1] == leg

        graph.spin_until(is_told, what=f"{leg}")

    newest_at(10.0, LEGS[0])
    newest_at(10.6, LEGS[1])
    newest_at(3.0, LEGS[0])
    newest_at(3.6, LEGS[1])
    assert program.running
    newest_at(4.1, LEGS[2])
    graph.ends(program)


def test_it_says_that_nobody_listens_and_what_is_wrong_with_a_course(graph):
    program = graph.start("drive", "--timeout", "1")
    graph.ends(program, 1)
    assert "Waited 1 s, but nobody takes /cmd_vel as TwistStamped" in program.output
    program = graph.start("drive", "figure_of_nine")
    graph.ends(program, 1)
    assert "The course 'figure_of_nine' cannot be read" in program.output
