# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a controller leaves on a bus that holds the last command, and what `watchdog` makes of it.

A forward controller of ros2_control holds what it was sent. `Bus` stands in for it.
"""

import os
import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from vgps_ros.messages.conversions import stamp_of, state_to_msg
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.storage.run_folder import save_policy

PERIOD = 20_000_000  # of the swimmer's control [ns]


class Bus:
    """A robot whose motors hold the last torques; it says what it measures 50 times a second."""

    def __init__(self, graph, task):
        self.graph, self.task, self.step = graph, task, 0
        self.held = np.zeros(task.dynamics.control_dim)
        subscribe = graph.node.create_subscription
        subscribe(Float64MultiArray, "commands", self._take, STREAM)
        self._states = graph.node.create_publisher(JointState, "joint_states", STREAM)
        graph.node.create_timer(0.02, self._publish)

    def _take(self, message):
        self.held = np.array(message.data)

    def _publish(self):
        self.step += 1
        stamp = stamp_of(self.step * PERIOD)
        self._states.publish(state_to_msg(np.ones(10), self.task.joint_names, stamp))


@pytest.fixture
def driven(graph, swimmer, random_policy, tmp_path):
    """A bus, and the executor that drives it."""
    save_policy(random_policy(0), "swimmer", tmp_path / "policy.json")
    bus = Bus(graph, swimmer)
    executor = graph.start(
        "policy_executor",
        policy_file=tmp_path / "policy.json",
        command_type="float64_multi_array",
    )
    graph.spin_until(lambda: any(bus.held), what="torques")
    return bus, executor


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_watchdog_sends_zero_torque_where_a_controller_is_killed_or_hangs(
    graph, driven, number
):
    bus, executor = driven
    graph.start("watchdog", silence=0.3)
    graph.diagnosis("watchdog", DiagnosticStatus.OK, "Running")
    graph.spin_for(1.0)
    assert bus.held.any()  # it leaves a controller that drives alone
    os.kill(executor.pid, number)
    graph.spin_until(lambda: not bus.held.any(), 10.0, "zero torque")
    graph.spin_for(1.0)
    assert not bus.held.any()
    said = graph.diagnosis("watchdog", None).message
    assert said == "Running."  # one that lies at rest is no fault any more
    executor.kill()


def test_targets_of_servos_are_left_alone(graph):
    graph.start("watchdog", silence=0.1, commands_are_efforts=False)
    sent = graph.publisher(JointState, "joint_command")
    heard = graph.messages(JointState, "joint_command")
    plain = graph.messages(Float64MultiArray, "commands")
    targets = graph.node.create_publisher(Float64MultiArray, "commands", STREAM)
    graph.spin_until(targets.get_subscription_count)
    targets.publish(Float64MultiArray(data=[1.0]))
    sent.publish(JointState(name=["a", "b"], position=[1.0, 2.0]))
    graph.spin_for(1.0)
    assert (len(heard), len(plain)) == (1, 1)
    sent.publish(JointState(name=["a", "b"], effort=[1.0, 2.0]))
    graph.spin_until(lambda: len(heard) == 3)
    assert list(heard[-1].effort) == [0.0, 0.0]
