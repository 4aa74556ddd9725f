# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Other programs in the domain of a graph: many of them, or one that floods its topics.

    python -m tests.faults.strangers flood 5
    python -m tests.faults.strangers crowd 30

A flood is bounded in time [s], and stays on the loopback interface, as all tests do.
A crowd, of so many participants, stays until it gets INT.
"""

import signal
import sys
import time
from array import array

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from vgps_msgs.msg import GaussianPolicy

from vgps_ros.ros_runtime.qos import LATCHED

LARGE = 1_000_000  # of a large message [bytes]
THERE = "They are there."


def flood(seconds: float) -> None:
    """Publishes valid, invalid and large messages as fast as the middleware takes them."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("flood")
    numbers = array("d", bytes(LARGE))
    status = DiagnosticStatus(name="/flood", hardware_id="vgps_ros")
    status.values = [KeyValue(key="instance", value="x" * LARGE)]
    valid = serialize_message(JointState(name=["x"] * 4, position=[0.5] * 4))
    messages = [
        ("joint_command", JointState, valid),
        ("joint_command", JointState, valid[:30]),
        ("joint_command", JointState, JointState(effort=numbers)),
        ("policy", GaussianPolicy, GaussianPolicy(parameters=numbers)),
        ("large_0", Float64MultiArray, Float64MultiArray(data=numbers)),
        ("large_1", Float64MultiArray, Float64MultiArray(data=numbers)),
        ("/diagnostics", DiagnosticArray, DiagnosticArray(status=[status])),
    ]
    profiles = {"policy": LATCHED}
    publishers = {
        topic: node.create_publisher(kind, topic, profiles.get(topic, QoSProfile(depth=10)))
        for topic, kind in {topic: kind for topic, kind, _ in messages}.items()
    }
    ready = [
        (publishers[topic], message if isinstance(message, bytes) else serialize_message(message))
        for topic, _, message in messages
    ]
    time.sleep(1.0)  # until they are discovered
    end, count = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        for publisher, data in ready:
            publisher.publish(data)
        count += len(ready)
    node.destroy_node()
    rclpy.shutdown()
    print(f"Published {count} messages in {seconds:g} s.", flush=True)


def crowd(count: int) -> None:
    """Joins the domain so many times."""
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    nodes = []
    for number in range(count):
        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        nodes.append((context, rclpy.create_node(f"stranger_{number}", context=context)))
    print(THERE, flush=True)
    signal.sigwait([signal.SIGINT])
    for context, node in nodes:
        node.destroy_node()
        rclpy.shutdown(context=context)


if __name__ == "__main__":
    {"flood": lambda: flood(float(sys.argv[2])), "crowd": lambda: crowd(int(sys.argv[2]))}[
        sys.argv[1]
    ]()
