# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The lifecycle of `policy_executor`: what each transition does, in any order, and what moves."""

import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import GetState
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from tests.nodes.conftest import Hardware, executed
from vgps_ros.messages.conversions import command_from_msg, nanoseconds, stamp_of, state_to_msg
from vgps_ros.ros_runtime.qos import COMMANDED, LATEST, STREAM
from vgps_ros.storage.run_folder import save_policy

OK, ERROR = DiagnosticStatus.OK, DiagnosticStatus.ERROR
CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE
STATES = ("unconfigured", "inactive", "active")
LEADS = {
    ("unconfigured", CONFIGURE): "inactive",
    ("inactive", CLEANUP): "unconfigured",
    ("inactive", ACTIVATE): "active",
    ("active", DEACTIVATE): "inactive",
}
PERIOD = 20_000_000  # of the swimmer's control [ns]
ONES = np.ones(10)  # a state of the swimmer
DAMPING = 2.0


class Robot:
    """A robot that stands still and says so, 50 times a second, and the executor of its policy."""

    def __init__(self, graph, task, policy, folder, **parameters):
        self.graph, self.task, self.step, self.state = graph, task, 0, ONES
        self.file = folder / "policy.json"
        save_policy(policy, "swimmer", self.file)
        self._commands = graph.messages(JointState, "joint_command")
        self._states = graph.node.create_publisher(JointState, "joint_states", STREAM)
        self.executor = graph.start(
            "policy_executor", autostart=False, policy_file=self.file, **parameters
        )
        graph.spin_until(lambda: graph.node.count_publishers("joint_command"))
        graph.node.create_timer(0.02, self._publish)

    def _publish(self):
        self.step += 1
        stamp = stamp_of(self.step * PERIOD)
        self._states.publish(state_to_msg(self.state, self.task.joint_names, stamp))

    def change(self, transition):
        return self.graph.change(transition)

    def is_in(self):
        return self.graph.call(GetState, "policy_executor/get_state").current_state.label

    def bring_to(self, state):
        for transition in {
            "unconfigured": (DEACTIVATE, CLEANUP),
            "inactive": (DEACTIVATE, CONFIGURE),
            "active": (CONFIGURE, ACTIVATE),
        }[state]:
            self.change(transition)
        assert self.is_in() == state

    def torques(self, duration=0.5):
        """Returns the torques of the commands that come from now on, shape (N, n_u)."""
        self.graph.spin_for(0.2)
        self._commands.clear()
        self.graph.spin_for(duration)
        controls = self.task.controls
        return np.array([command_from_msg(c, controls) for c in self._commands]).reshape(-1, 2)

    def last(self):
        return command_from_msg(self._commands[-1], self.task.controls)

    def stop(self, is_on):
        request = SetBool.Request(data=is_on)
        return self.graph.call(SetBool, "policy_executor/emergency_stop", request)


@pytest.fixture(scope="module")
def shared_robot(shared_graph, swimmer, random_policy):
    return Robot(shared_graph, swimmer, random_policy(0), shared_graph.folder)


@pytest.fixture
def robot(shared_robot):
    yield shared_robot
    assert shared_robot.executor.running


@pytest.mark.parametrize(("state", "transition"), [*product(STATES, (1, 2, 3, 4))])
def test_each_transition_in_each_state_moves_the_robot_only_where_it_activates(
    robot, random_policy, state, transition
):
    robot.bring_to(state)
    after = LEADS.get((state, transition), state)
    assert robot.change(transition) == ((state, transition) in LEADS)
    assert robot.is_in() == after
    torques = robot.torques()
    if after == "active":
        wanted = executed(random_policy(0), ONES[1:])
        assert len(torques) > 5
        assert (torques == wanted).all()
    else:
        assert len(torques) == 0


def test_another_policy_file_is_loaded_by_cleanup_and_configure(robot, random_policy, tmp_path):
    robot.bring_to("unconfigured")
    save_policy(random_policy(1), "swimmer", tmp_path / "other.json")
    for file, seed in (("absent.json", None), ("other.json", 1)):
        path = str(tmp_path / file)
        assert robot.graph.set_parameter("policy_executor", "policy_file", path).successful
        assert robot.change(CONFIGURE) == (seed is not None)
        if seed is None:
            robot.graph.diagnosis("policy_executor", ERROR, "Not configured: ")
            assert robot.is_in() == "unconfigured"
    assert robot.change(ACTIVATE)
    assert (robot.torques() == executed(random_policy(1), ONES[1:])).all()
    robot.bring_to("unconfigured")
    robot.graph.set_parameter("policy_executor", "policy_file", str(robot.file))
    robot.bring_to("active")
    assert (robot.torques() == executed(random_policy(0), ONES[1:])).all()


@pytest.mark.parametrize("by", ["service", "latched", "best effort"])
def test_an_emergency_stop_holds_until_it_is_released_and_the_node_activated_again(robot, by):
    def stop(is_on):
        if by == "service":
            assert robot.stop(is_on).success
        else:
            publisher.publish(Bool(data=is_on))
            robot.graph.spin_for(0.5)

    if by != "service":
        qos = LATEST if by == "latched" else COMMANDED
        publisher = robot.graph.publisher(Bool, "emergency_stop", qos)
    robot.bring_to("active")
    assert robot.torques().any()
    stop(True)
    torques = robot.torques()
    assert len(torques) > 5
    assert not torques.any()
    sentence = "Safe action active (zero): there is an emergency stop."
    robot.graph.diagnosis("policy_executor", ERROR, sentence)
    assert robot.change(DEACTIVATE)
    assert not robot.change(ACTIVATE)
    assert robot.change(CLEANUP)
    assert robot.change(CONFIGURE)
    assert not robot.change(ACTIVATE)
    assert len(robot.torques()) == 0
    stop(False)
    assert len(robot.torques()) == 0  # nothing moves by itself
    assert robot.change(ACTIVATE)
    assert robot.torques().any()
    if by != "service":
        robot.graph.node.destroy_publisher(publisher)


def test_one_that_is_released_while_the_node_is_active_does_not_let_the_policy_drive(robot):
    robot.bring_to("active")
    assert robot.stop(True).message == "There is an emergency stop."
    assert robot.stop(False).message.startswith("Released; deactivate and activate")
    torques = robot.torques()
    assert len(torques) > 5
    assert not torques.any()
    robot.bring_to("inactive")


def test_a_latched_stop_from_before_the_start_keeps_it_from_starting(
    graph, swimmer, random_policy, tmp_path
):
    graph.node.create_publisher(Bool, "emergency_stop", LATEST).publish(Bool(data=True))
    robot = Robot(graph, swimmer, random_policy(0), tmp_path)
    graph.spin_for(1.0)
    assert robot.change(CONFIGURE)
    assert not robot.change(ACTIVATE)
    graph.spin_until_output(robot.executor, "Not activated: There is an emergency stop.")


def test_after_a_deactivation_the_safe_action_drives_for_a_while_and_leaves_zero_torque(
    graph, swimmer, random_policy, tmp_path
):
    settings = {"safe_action": "damping", "damping": DAMPING, "settle_duration": 1.0}
    robot = Robot(graph, swimmer, random_policy(0), tmp_path, **settings)
    robot.bring_to("active")
    assert robot.torques().any()
    robot.change(DEACTIVATE)
    braked = robot.torques(0.3)
    assert len(braked) > 3
    assert (braked == -DAMPING).all()  # all joints move at 1 rad/s
    graph.diagnosis("policy_executor", ERROR, "Safe action active (damping): the node is deact")
    graph.spin_until(lambda: not robot.last().any(), what="the last command")
    graph.spin_for(0.2)  # it is a single one
    count = len(robot._commands)
    graph.spin_for(0.5)
    assert len(robot._commands) == count
    graph.diagnosis("policy_executor", OK, "Running")
    stamps = [nanoseconds(c.header.stamp) for c in robot._commands]
    assert stamps == sorted(stamps)


def test_it_stands_up_before_the_policy_drives_holds_and_sits_down(
    graph, swimmer, random_policy, tmp_path
):
    gains = {"pose_stiffness": 10.0, "pose_damping": 3.0, "pose_integral": 0.0}
    settings = {"stand_duration": 1.0, "sit_duration": 0.5, **gains}
    robot = Robot(graph, swimmer, random_policy(0), tmp_path, **settings)
    driven = executed(random_policy(0), ONES[1:])

    def does(name):
        return graph.call(Trigger, f"policy_executor/{name}")

    assert not does("stand").success  # it is not even configured
    robot.bring_to("active")
    # From the measured pose, 1 rad, where only damping acts, towards 0 rad.
    graph.spin_until(lambda: len(robot._commands) > 3)
    assert np.all(np.abs(command_from_msg(robot._commands[0], swimmer.controls) + 3.0) < 1e-9)
    graph.spin_until(lambda: np.array_equal(robot.last(), driven), what="the policy")
    standing = [command_from_msg(c, swimmer.controls) for c in robot._commands[1:-1]]
    standing = [torques for torques in standing if not np.array_equal(torques, driven)]
    assert all(np.all((torques <= -3.0) & (torques >= -13.0)) for torques in standing)
    assert np.ptp(standing, axis=0).min() > 3.0

    assert does("hold").message == "It holds its pose."
    assert (robot.torques() == -3.0).all()  # it is where it is held, and moves
    assert does("sit").message == "It sits down."
    graph.spin_until(lambda: np.all(robot.last() == -3.0))
    assert does("stand").success
    graph.spin_for(1.5)
    np.testing.assert_allclose(robot.torques(), -13.0)
    assert does("drive").message == "It stands up."
    graph.spin_until(lambda: np.array_equal(robot.last(), driven), what="the policy")
    robot.stop(True)
    assert does("drive").message == "There is an emergency stop."
    robot.stop(False)
    assert does("drive").message == "Nothing moves: activate the node again first."
    assert not robot.torques().any()


def test_a_cleanup_stops_listening_and_each_configure_reads_the_task_file_anew(graph, told):
    node, file = graph.start("policy_executor", task=told, autostart=False), Path(told)
    graph.spin_until_output(node, "Waiting to be configured")
    text = file.read_text()

    def listens(count):
        heard = graph.node.count_subscribers
        return all(heard(topic) == count for topic in ("joint_states", "policy"))

    for _ in range(2):
        assert graph.change(CONFIGURE)
        graph.spin_until(lambda: listens(1), what="one subscription of each topic")
        assert graph.change(CLEANUP)
        graph.spin_until(lambda: listens(0), what="no subscription")
    file.write_text(text.replace("lift", "rise"))
    for _ in range(2):
        assert not graph.change(CONFIGURE)
        graph.diagnosis("policy_executor", ERROR, "start the node again")
    file.write_text(text)
    assert graph.change(CONFIGURE)


def test_with_autostart_it_starts_once_and_never_by_itself_again(
    graph, swimmer, random_policy, tmp_path
):
    save_policy(random_policy(0), "swimmer", tmp_path / "policy.json")
    executor = graph.start("policy_executor", policy_file=tmp_path / "policy.json")
    robot = Hardware(graph, swimmer)
    robot.answer(ONES)
    for transition in (DEACTIVATE, CLEANUP, CONFIGURE):
        assert graph.change(transition)
    graph.spin_for(2.0)
    robot.commands.clear()
    for _ in range(10):
        robot.send(ONES)
        graph.spin_for(0.05)
    assert not robot.commands
    assert executor.running


def test_without_autostart_it_says_how_to_start_it_and_a_refusal_at_the_start_is_told_once(
    graph, tmp_path
):
    waiting = graph.start(
        "policy_executor", "--ros-args", "-r", "__ns:=/a", "-p", "autostart:=false"
    )
    graph.spin_until_output(waiting, "ros2 lifecycle set /a/policy_executor configure")
    refused = graph.start("policy_executor", policy_file=tmp_path / "absent.json")
    assert refused.wait() == 1
    assert refused.output.count("is not a readable policy file") == 1


def test_an_error_that_nobody_foresaw_is_told_by_its_type_and_message(graph):
    program = (
        "from vgps_ros.nodes.policy_executor import NODE\n"
        "from vgps_ros.ros_runtime import controller, runner\n"
        "controller._Session = lambda node: {}['what nobody foresaw']\n"
        "raise SystemExit(runner.run(NODE))\n"
    )
    node = graph.start_command("policy_executor", [sys.executable, "-c", program])
    assert node.wait() == 1
    assert node.output.count("KeyError: 'what nobody foresaw'") == 1
    assert "Traceback" not in node.output
