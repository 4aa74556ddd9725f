# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Robots of servos and of geared motors through the graph: what is sent, and who holds them."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tests.nodes.conftest import Hardware
from tests.servo_arm import GEARED, SERVOS, write_arm
from vgps_ros.bags import BagReader
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.bags.episode import episodes
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import command_from_msg, command_to_msg, state_from_msg
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

PERIOD = 20_000_000  # [ns]
ERROR, OK = DiagnosticStatus.ERROR, DiagnosticStatus.OK


def positions(graph, states, task, count=60):
    """The joints' positions over some more states, shape (N, n)."""
    states.clear()
    graph.spin_until(lambda: len(states) >= count, what="states")
    return np.array([state_from_msg(m, task.joint_names) for m in states])[
        :, : len(task.joint_names)
    ]


def test_in_real_time_servos_hold_the_arm_without_a_command_and_after_one(graph, tmp_path):
    task = make_task(write_arm(tmp_path, SERVOS))
    states = graph.messages(JointState, "joint_states")
    graph.start("simulation", task=task.name, mode="real_time", command_timeout=0.3)
    commands = graph.publisher(JointState, "joint_command")
    start = task.initial_state[:2]
    # It sinks by what its weight needs of its servos, 3.6 N·m / (120 N·m/rad), and at first by
    # twice as much.
    assert np.abs(positions(graph, states, task) - start).max() < 0.07

    moved = np.array([0.9, -0.3])  # elbow and shoulder
    for _ in range(40):
        stamp = states[-1].header.stamp
        commands.publish(command_to_msg(moved, task.controls, stamp))
        graph.spin_for(0.02)
    sentence = "No joint_command for 0.3 s, so the servos hold their positions"
    graph.diagnosis("simulation", ERROR, sentence)
    found = positions(graph, states, task)
    # Wherever it was when the commands ended, on a slow machine also before.
    np.testing.assert_allclose(found[-1], moved[::-1], atol=0.3)
    assert np.ptp(found[-30:], axis=0).max() < 0.02  # it stays


def driven(graph, task, output, **parameters):
    """The hardware of an executor with a linear policy of constant outputs."""
    graph.start("policy_executor", task=task.name, **parameters)
    shape = Architecture(task.observation.names, (), len(output))
    count = shape.num_parameters - len(output)
    policy = GaussianPolicy(shape, [*np.zeros(count), *output], np.ones(len(output)))
    graph.publish_policy(policy, task.name)
    graph.diagnosis("policy_executor", OK, "Waiting for joint_states")
    return Hardware(graph, task)


def last_of(robot):
    """Deactivates the executor; returns its last command."""
    robot.commands.clear()
    assert robot.graph.change(Transition.TRANSITION_DEACTIVATE)
    robot.graph.spin_until(lambda: robot.commands, what="the last command")
    return robot.commands[-1]


def test_an_executor_sends_servos_targets_and_leaves_them_at_the_measured_pose(graph, tmp_path):
    task = make_task(write_arm(tmp_path, SERVOS))
    arm = driven(graph, task, [0.4, -0.6])
    message = arm.message([-0.7, 0.5, 0.1, 0.2], PERIOD)
    assert list(message.name) == ["elbow", "shoulder"]
    assert (list(message.position), list(message.effort)) == ([0.4, -0.6], [])
    assert list(last_of(arm).position) == [0.5, -0.7]


def test_a_geared_motors_command_is_the_torque_on_its_joint(graph, tmp_path):
    task = make_task(write_arm(tmp_path, GEARED))
    rod = driven(graph, task, [0.5], safe_action="damping", damping=2.0, state_timeout=1000.0)
    message = rod.message([-0.7, 3.0], PERIOD)
    assert (list(message.position), list(message.effort)) == ([], [25.0])
    assert command_from_msg(message, task.controls).tolist() == [0.5]
    rod.commands.clear()
    rod.send([np.nan, 3.0], 2 * PERIOD)
    graph.spin_until(lambda: rod.commands, what="the safe action")
    assert list(rod.commands[-1].effort) == [-2.0 * 3.0]
    assert list(last_of(rod).effort) == [0.0]


@pytest.mark.slow
def test_forward_controllers_of_ros2_control_get_what_their_interfaces_are(graph, tmp_path):
    task = make_task(write_arm(tmp_path, SERVOS))
    of_elbow = graph.messages(Float64MultiArray, "elbow/commands")
    of_shoulder = graph.messages(Float64MultiArray, "shoulder/commands")
    arm = driven(
        *(graph, task, [0.4, -0.6]),
        command_type="float64_multi_array",
        command_interfaces="position,velocity,effort,stiffness,damping",
    )
    state = [-0.7, 0.5, 0.0, 0.0]
    graph.spin_until(lambda: arm.send(state, PERIOD) or graph.spin_for(0.05) or of_elbow)
    assert list(of_elbow[0].data) == [0.4, 0.0, 0.0, 60.0, 0.0]
    graph.spin_until(lambda: of_shoulder)
    assert list(of_shoulder[0].data) == [-0.6, 0.0, 0.0, 120.0, 0.0]


def test_controls_of_two_kinds_are_refused_where_one_array_would_hold_them(graph, tmp_path):
    servo, motor = '<position name="second" joint="elbow" kp="60"/>', '<motor joint="elbow"/>'
    name = write_arm(tmp_path, SERVOS.replace(servo, motor))
    node = graph.start("policy_executor", task=name, command_type="float64_multi_array")
    graph.ends(node, 1)
    assert "set command_interfaces to 'effort,position'" in node.output


def test_an_interface_that_the_controls_are_not_is_refused(graph, tmp_path):
    name = write_arm(tmp_path, SERVOS)
    node = graph.start("policy_executor", task=name, command_interfaces="effort")
    assert node.wait() == 1
    assert "the controls are position [rad]; name position, too." in node.output


@pytest.mark.parametrize("mjcf", [SERVOS, pytest.param(GEARED, marks=pytest.mark.slow)])
def test_a_bag_of_such_a_robot_is_checked_to_the_bit_with_its_last_command(mjcf, graph, tmp_path):
    task = make_task(write_arm(tmp_path, mjcf))
    n_u = len(task.controls.names)
    shape = Architecture(task.observation.names, (), n_u)
    rng = np.random.default_rng(2)
    policy = GaussianPolicy(shape, 0.3 * rng.standard_normal(shape.num_parameters), np.ones(n_u))
    save_policy(policy, task.name, tmp_path / "policy.json")
    limits = {"torque_limits": [20.0] * n_u, "torque_rate_limit": 300.0}
    given = {"policy_file": tmp_path / "policy.json", **limits}
    graph.record_run(40, task.name, to_its_end=True, **given)
    with BagReader(tmp_path / "bag") as bag:
        episode = episodes(bag, task.dynamics.model)[-1]
        commands = [m for _, m in bag.decoded(bag.needed_topic("joint_command"))]
    # The torques at the joints that the targets asked for, by MuJoCo, were within the limit.
    control, state = episode.controls[1], episode.states[0]
    low, high = task.controls.bounds(state, np.full(n_u, 20.0))
    assert ((low - 1e-12 <= control) & (control <= high + 1e-12)).all()
    rest = task.controls.at_joints(task.controls.resting(episode.states[-1]))
    last = {"position": commands[-1].position, "effort": commands[-1].effort}
    (field,) = task.controls.fields
    np.testing.assert_array_equal(last[field], rest)
    found = check_bag(tmp_path / "bag")
    assert found.wrong == []
    assert found.counts["safe"] == 1
    assert found.counts["mean"] >= 40
    assert any("40 of 40 steps" in sentence for sentence in found.proved), found.proved
