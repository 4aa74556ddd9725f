# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Messages of others cannot take all of a node's memory, however large or many they are."""

import os
import signal

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tests.nodes.conftest import private_memory
from vgps_ros.messages.conversions import pack
from vgps_ros.ros_runtime.inbox import Inbox
from vgps_ros.ros_runtime.qos import LATCHED, STREAM

EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
SIZE = 2_000_000  # of a large message [bytes]
COUNT = 600  # of them, 1.2 GB in all
MOST = 700.0  # far below that, and above what a node may take before it gives messages up [MB]


class Sender:
    """A node of another context, since one of the same would share the messages' memory."""

    def __init__(self, graph):
        self.context = rclpy.Context()
        rclpy.init(
            context=self.context,
            domain_id=graph.domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node("stranger", context=self.context)

    def close(self):
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def test_unread_messages_are_given_up_where_they_take_too_much_memory(graph):
    inbox, sender = Inbox(graph.node), Sender(graph)
    count = 0

    def take(message: Float64MultiArray) -> None:
        nonlocal count
        count += 1

    try:
        inbox.subscribe(Float64MultiArray, "large", take, STREAM, largest=2 * SIZE)
        large = sender.node.create_publisher(Float64MultiArray, "large", QoSProfile(depth=1))
        graph.spin_until(large.get_subscription_count)
        message = Float64MultiArray(data=pack([0.5] * (SIZE // 8)))
        graph.spin_for(1.0)
        before = private_memory(os.getpid())
        for _ in range(COUNT):
            large.publish(message)
            if private_memory(os.getpid()) > before + 3.0 * MOST:
                break
        risen = private_memory(os.getpid()) - before
        graph.spin_until(lambda: inbox.dropped["large"], what="messages that are given up")
        graph.spin_for(1.0)
        assert "of large: what waited there took more than" in inbox.warning()
        assert private_memory(os.getpid()) < before + 0.5 * risen
        # Of those that come now only few wait, and the newest are still taken.
        for _ in range(COUNT):
            large.publish(message)
        assert private_memory(os.getpid()) < before + MOST
        before_these = count
        graph.spin_until(lambda: count > before_these)
    finally:
        sender.close()


def test_a_message_larger_than_its_topic_needs_is_dropped_unread(graph):
    simulation = graph.start("simulation", start_paused=True)
    graph.diagnosis("simulation", DiagnosticStatus.OK)
    commands = graph.publisher(JointState, "joint_command", STREAM)
    commands.publish(JointState(position=pack([0.0] * (SIZE // 8))))
    graph.diagnosis("simulation", DiagnosticStatus.WARN, "1 of joint_command: larger than")
    values = [KeyValue(key="x" * 300_000)]
    status = DiagnosticStatus(name="/stranger", hardware_id="vgps_ros", values=values)
    # Nodes listen with best effort, so that some may be lost.
    diagnostics = graph.publisher(DiagnosticArray, "/diagnostics", STREAM)
    for _ in range(30):
        diagnostics.publish(DiagnosticArray(status=[status]))
        graph.spin_for(0.1)
    graph.diagnosis("simulation", DiagnosticStatus.WARN, "of /diagnostics: larger than")
    graph.diagnosis("simulation", DiagnosticStatus.OK)  # when it has said so for a while
    assert simulation.running


def test_latched_messages_come_once_though_the_subscription_is_made_anew(graph):
    """As a recorder would write them twice."""
    inbox, came = Inbox(graph.node), []
    publisher = graph.node.create_publisher(JointState, "latched", LATCHED)
    for number in range(3):
        publisher.publish(JointState(name=[str(number)]))
    inbox.subscribe_raw(JointState, "latched", lambda data, _: came.append(data), LATCHED, EVENTS)
    graph.spin_until(lambda: len(came) == 3)
    (stream,) = inbox._streams
    stream.largest = 10**9  # as if a large one had come, too
    stream.shorten(graph.node)
    publisher.publish(JointState(name=["new"]))
    graph.spin_until(lambda: len(came) > 3)
    graph.spin_for(0.5)
    assert len(came) == 4


def test_memory_of_a_backlog_is_given_back_once_it_is_read(graph, tmp_path):
    recorder, sender = graph.start("recorder", output=tmp_path / "bag"), Sender(graph)
    try:
        large = sender.node.create_publisher(Float64MultiArray, "large", QoSProfile(depth=COUNT))
        graph.spin_until(large.get_subscription_count)
        message = Float64MultiArray(data=pack([0.5] * (SIZE // 8)))

        before = highest = private_memory(recorder.pid)
        recorder.send(signal.SIGSTOP)
        for _ in range(60):
            large.publish(message)
        recorder.send(signal.SIGCONT)
        for _ in range(30):
            graph.spin_for(0.1)
            highest = max(highest, private_memory(recorder.pid))
        assert highest > before + 50.0
        half = before + 0.5 * (highest - before)
        graph.spin_until(
            lambda: private_memory(recorder.pid) < half, what="memory that is given back"
        )
    finally:
        sender.close()


def test_large_messages_leave_little_memory_behind(graph):
    """The C library would keep 15 MB, in a heap of a thread of the middleware."""
    simulation, sender = graph.start("simulation", start_paused=True), Sender(graph)
    try:
        graph.diagnosis("simulation", DiagnosticStatus.OK)
        commands = sender.node.create_publisher(JointState, "joint_command", QoSProfile(depth=10))
        graph.spin_until(commands.get_subscription_count)
        message = JointState(effort=pack([0.5] * (SIZE // 16)))
        graph.spin_for(2.0)
        before = private_memory(simulation.pid)
        for _ in range(300):
            commands.publish(message)
            graph.spin_for(0.01)
        left = before + 5.0
        graph.spin_until(lambda: private_memory(simulation.pid) < left, what="memory given back")
        graph.spin_for(3.0)
        assert private_memory(simulation.pid) < left
    finally:
        sender.close()
