# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Whether a node is alive, as those see it that need it."""

import signal
import sys

import pytest
from std_msgs.msg import String

from vgps_ros.ros_runtime.qos import Liveness

_TALKER = """
import rclpy
from std_msgs.msg import String
from vgps_ros.ros_runtime.qos import lively
from vgps_ros.ros_runtime.qos import STREAM

rclpy.init()
node = rclpy.create_node("talker")
node.create_publisher(String, "words", lively(STREAM))
try:
    rclpy.spin(node)
except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
    node.destroy_node()
"""


@pytest.fixture
def life(graph):
    return Liveness(graph.node, String, "words")


def start_talker(graph, life):
    process = graph.start_command("talker", [sys.executable, "-c", _TALKER])
    graph.spin_until(lambda: life.is_alive, what="the talker")
    return process


def test_a_node_that_is_killed_is_lost_and_the_next_one_is_alive(graph, life):
    start_talker(graph, life).kill()
    graph.spin_until(lambda: not life.is_alive, 10.0, "the loss")
    assert life.losses == 1
    start_talker(graph, life)
    assert life.losses == 1


def test_a_node_that_is_back_before_it_was_missed_was_lost(graph, life):
    start_talker(graph, life).kill()
    start_talker(graph, life)
    graph.spin_until(lambda: life.losses == 1 and life.is_alive, what="the loss and the return")


def test_a_node_that_hangs_is_lost_until_it_goes_on(graph, life):
    talker = start_talker(graph, life)
    talker.send(signal.SIGSTOP)
    try:
        graph.spin_until(lambda: not life.is_alive, 10.0, "the loss")
    finally:
        talker.send(signal.SIGCONT)
    graph.spin_until(lambda: life.is_alive, 10.0, "its return")


def test_a_node_that_ends_is_lost_at_once(graph, life):
    assert start_talker(graph, life).end(signal.SIGINT) == 0
    graph.spin_until(lambda: not life.is_alive, 2.0, "the loss")
    assert life.losses == 1
