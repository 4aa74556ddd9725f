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
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from tests.nodes.test_servos import driven as driven_arm
from tests.servo_arm import SERVOS, write_arm
from vgps_ros.messages.conversions import stamp_of, state_to_msg
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

PERIOD = 20_000_000  # of the swimmer's control [ns]


def an_array(label):
    dimension = [MultiArrayDimension(label=label)] if label else []
    return Float64MultiArray(layout=MultiArrayLayout(dim=dimension), data=[1.0])


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
        "policy_executor", policy_file=tmp_path / "policy.json", command_type="float64_multi_array"
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


@pytest.mark.parametrize("label", ["position", "", "position,effort"])
def test_what_zeros_would_move_or_who_knows_what_is_left_alone(graph, label):
    graph.start("watchdog", silence=0.1)
    plain = graph.messages(Float64MultiArray, "commands")
    targets = graph.node.create_publisher(Float64MultiArray, "commands", STREAM)
    graph.spin_until(lambda: targets.get_subscription_count() == 2)  # its own, and this test's
    targets.publish(an_array(label))
    graph.spin_for(1.0)
    assert len(plain) == 1
    if label != "position":
        warned = graph.diagnosis("watchdog", DiagnosticStatus.WARN, "are left alone")
        assert f"label is '{label}'; set it to effort, velocity or position." in warned.message
    targets.publish(an_array("effort"))
    graph.spin_until(lambda: len(plain) == 3)
    assert list(plain[-1].data) == [0.0]


def test_of_joint_states_targets_of_servos_are_left_alone(graph):
    graph.start("watchdog", silence=0.1)
    sent = graph.publisher(JointState, "joint_command")
    heard = graph.messages(JointState, "joint_command")
    graph.spin_until(lambda: sent.get_subscription_count() == 2)
    sent.publish(JointState(name=["a", "b"], position=[1.0, 2.0]))
    graph.spin_for(1.0)
    assert len(heard) == 1
    sent.publish(JointState(name=["a", "b"], effort=[1.0, 2.0]))
    graph.spin_until(lambda: len(heard) == 3)
    assert list(heard[-1].effort) == [0.0, 0.0]


def test_a_servos_targets_stay_where_its_controller_is_killed(graph, tmp_path):
    task = make_task(write_arm(tmp_path, SERVOS))
    commands = graph.messages(Float64MultiArray, "commands")
    graph.start("watchdog", silence=0.1)
    graph.diagnosis("watchdog", DiagnosticStatus.OK, "Running")
    arm = driven_arm(graph, task, [0.4, -0.6], command_type="float64_multi_array")
    state = [-0.7, 0.5, 0.0, 0.0]
    graph.spin_until(lambda: arm.send(state, PERIOD) or graph.spin_for(0.05) or commands)
    assert commands[0].layout.dim[0].label == "position"
    graph.processes[-1].kill()
    graph.spin_for(1.0)
    assert all(list(message.data) == [0.4, -0.6] for message in commands)
    assert graph.diagnosis("watchdog", None).message == "Running."
