# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The node `simulation`, driven by the test in the executor's place."""

import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from simulation_interfaces.msg import Result, SimulationState
from simulation_interfaces.srv import (
    GetSimulationState,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)

from tests.nodes.conftest import EACH_SIGNAL, PATIENCE, values_of
from vgps_ros.messages.conversions import nanoseconds, pack, state_from_msg
from vgps_ros.ros_runtime.qos import STREAM

PERIOD = 20_000_000  # of the swimmer's control [ns]
STOPPED = SimulationState.STATE_STOPPED
PLAYING = SimulationState.STATE_PLAYING
PAUSED = SimulationState.STATE_PAUSED


class Robot:
    """The simulation as a controller sees it."""

    def __init__(self, graph, task):
        self.graph = graph
        self.task = task
        self.states = graph.messages(JointState, "joint_states")
        self.clocks = graph.messages(Clock, "/clock")
        self.commands = graph.publisher(JointState, "joint_command")

    def next_state(self, stamp):
        """Waits for the state of this time [ns] and takes note that it has come."""

        def found():
            return next((s for s in self.states if nanoseconds(s.header.stamp) == stamp), None)

        message = self.graph.spin_until(found, what=f"the state of {stamp} ns")
        self.states.clear()
        return message

    def wait_for(self, expected):
        """Waits until the state equals this one."""
        names = self.task.joint_names
        self.graph.spin_until(
            lambda: any(np.array_equal(state_from_msg(s, names), expected) for s in self.states)
        )

    def command(self, torques, stamp_from, names=None):
        names = self.task.actuated_joint_names if names is None else names
        torques = np.array(torques, dtype=float)
        message = JointState(header=stamp_from.header, name=names, effort=pack(torques))
        self.commands.publish(message)

    def set_state(self, state):
        request = SetSimulationState.Request(state=SimulationState(state=state))
        name = "simulation/set_simulation_state"
        return self.graph.call(SetSimulationState, name, request).result

    def get_state(self):
        return self.graph.call(GetSimulationState, "simulation/get_simulation_state").state.state

    def reset(self, scope=0):
        request = ResetSimulation.Request(scope=scope)
        return self.graph.call(ResetSimulation, "simulation/reset_simulation", request).result

    def steps(self, steps):
        """Returns the future of the service's answer."""
        request = StepSimulation.Request(steps=steps)
        return self.graph.call_async(StepSimulation, "simulation/step_simulation", request)


@pytest.fixture(scope="module")
def process(shared_graph):
    return shared_graph.start("simulation", wait_timeout=PATIENCE)


@pytest.fixture(scope="module")
def shared_robot(shared_graph, process, swimmer):
    return Robot(shared_graph, swimmer)


@pytest.fixture
def robot(shared_robot, process):
    """The same process for all tests: playing, at time 0."""
    shared_robot.set_state(STOPPED)
    shared_robot.states.clear()
    shared_robot.clocks.clear()
    shared_robot.set_state(PLAYING)
    yield shared_robot
    assert process.running


def test_alone_it_says_once_what_it_waits_for_and_then_reports_an_error(graph):
    process = graph.start("simulation", wait_timeout=0.5)
    graph.spin_until_output(process, "Waiting for joint_command from policy_executor.")
    graph.diagnosis("simulation", DiagnosticStatus.ERROR, "Still waiting for joint_command")
    graph.spin_for(1.5)
    assert process.output.count("Waiting for joint_command") == 1
    assert process.output.count("Still waiting") == 1


def test_each_command_brings_the_next_state_and_the_clock(robot):
    torques = np.array([1.0, -2.0])
    expected = robot.task.initial_state
    for step in range(4):
        message = robot.next_state(step * PERIOD)
        np.testing.assert_array_equal(state_from_msg(message, robot.task.joint_names), expected)
        robot.command(torques, message)
        expected = robot.task.dynamics.step(expected, torques)
    robot.next_state(4 * PERIOD)
    robot.graph.spin_until(lambda: {nanoseconds(m.clock) for m in robot.clocks} >= {4 * PERIOD})


def test_an_unanswered_state_is_sent_again(robot):
    first = robot.next_state(0)
    second = robot.next_state(0)
    assert first.position == second.position


def test_a_second_answer_to_the_same_state_changes_nothing(robot):
    state = robot.next_state(0)
    robot.command([1.0, 1.0], state)
    robot.command([5.0, 5.0], state)
    after = state_from_msg(robot.next_state(PERIOD), robot.task.joint_names)
    expected = robot.task.dynamics.step(robot.task.initial_state, np.ones(2))
    np.testing.assert_array_equal(after, expected)


@pytest.mark.parametrize(
    ("torques", "names", "sentence"),
    [
        ([1.0, float("nan")], None, "joint_command.effort is nan at index 1"),
        ([1.0, 2.0], ["front_joint", "knee"], "['front_joint', 'knee']"),
        ([1.0], None, "joint_command.effort has 1 values"),
        ([1.0, 1e12], None, "joint_command.effort is 1e+12 for back_joint"),
    ],
)
def test_a_bad_command_is_ignored_with_a_sentence(robot, torques, names, sentence):
    state = robot.next_state(0)
    robot.command(torques, state, names)
    robot.graph.diagnosis("simulation", DiagnosticStatus.ERROR, sentence)
    robot.command([1.0, 1.0], state)
    robot.next_state(PERIOD)


def test_a_command_for_another_time_is_ignored_with_a_sentence(robot):
    state = robot.next_state(0)
    late = JointState()
    late.header.stamp.sec = 7
    robot.command([1.0, 1.0], late)
    robot.graph.diagnosis("simulation", DiagnosticStatus.ERROR, "its stamp is 7 s")
    assert not [s for s in robot.states if nanoseconds(s.header.stamp) > 0]
    robot.command([1.0, 1.0], state)
    robot.next_state(PERIOD)
    robot.graph.diagnosis("simulation", DiagnosticStatus.OK)


def test_a_diverged_state_pauses_with_a_sentence_until_it_is_reset(robot):
    robot.command([1e9, 0.0], robot.next_state(0))
    robot.graph.diagnosis("simulation", DiagnosticStatus.ERROR, "The state diverged at 0 s")
    assert robot.get_state() == PAUSED
    assert robot.reset().result == Result.RESULT_OK
    robot.wait_for(robot.task.initial_state)
    robot.graph.diagnosis("simulation", DiagnosticStatus.OK)


def test_steps_are_done_while_paused_and_answered_after_the_last(robot):
    robot.set_state(PAUSED)
    robot.states.clear()
    answer = robot.steps(3)
    robot.graph.spin_until(lambda: robot.get_state() == PLAYING)
    for step in range(3):
        assert not answer.done()
        robot.command([1.0, 0.0], robot.next_state(step * PERIOD))
    robot.graph.spin_until(answer.done)
    assert answer.result().result.result == Result.RESULT_OK
    assert robot.get_state() == PAUSED
    # A command for the state where it stands moves nothing now.
    robot.command([1.0, 0.0], robot.next_state(3 * PERIOD))
    robot.next_state(3 * PERIOD)


def test_a_reset_ends_steps_early_and_tells_their_caller(robot):
    robot.set_state(PAUSED)
    answer = robot.steps(2)
    robot.graph.spin_until(lambda: robot.get_state() == PLAYING)
    assert robot.reset().result == Result.RESULT_OK
    robot.graph.spin_until(answer.done)
    assert answer.result().result.result == Result.RESULT_OPERATION_FAILED
    assert "reset" in answer.result().result.error_message


def test_a_reset_takes_time_and_state_back_one_by_one_or_both(robot):
    start = robot.task.initial_state
    robot.command([9.0, 0.0], robot.next_state(0))
    moved = state_from_msg(robot.next_state(PERIOD), robot.task.joint_names)
    robot.set_state(PAUSED)
    robot.states.clear()

    robot.reset(ResetSimulation.Request.SCOPE_TIME)
    after = state_from_msg(robot.next_state(0), robot.task.joint_names)
    np.testing.assert_array_equal(after, moved)
    robot.reset(ResetSimulation.Request.SCOPE_STATE)
    robot.wait_for(start)
    robot.set_state(STOPPED)
    assert robot.get_state() == STOPPED


def test_the_initial_state_is_a_parameter_that_the_next_reset_uses(robot):
    wanted = (0.1 * np.arange(10)).tolist()
    assert robot.graph.set_parameter("simulation", "initial_state", wanted).successful
    robot.set_state(PAUSED)
    robot.states.clear()
    robot.reset()
    robot.wait_for(wanted)
    original = robot.task.initial_state.tolist()
    assert robot.graph.set_parameter("simulation", "initial_state", original).successful


@pytest.mark.parametrize(
    ("name", "wrong", "sentence"),
    [
        ("initial_state", [0.0, 1.0], "initial_state has 2 values"),
        ("initial_state", [float("nan")] * 10, "initial_state is nan"),
        ("command_timeout", -1.0, "command_timeout"),
        ("command_timeout", "soon", "DOUBLE"),
        ("mode", "real_time", "mode"),
    ],
)
def test_a_wrong_parameter_is_refused_while_it_runs(robot, name, wrong, sentence):
    result = robot.graph.set_parameter("simulation", name, wrong)
    assert not result.successful
    assert sentence in result.reason


@pytest.mark.parametrize(
    ("parameters", "sentences"),
    [
        ({"mode": "fast"}, ["mode is 'fast'", "lock_step, real_time"]),
        ({"initial_state": [0.5]}, ["initial_state has 1 values"]),
    ],
)
def test_a_wrong_parameter_ends_the_start_with_a_sentence(graph, parameters, sentences):
    process = graph.start("simulation", **parameters)
    assert process.wait() == 1
    assert all(sentence in process.output for sentence in sentences)
    assert "Traceback" not in process.output


def test_real_time_follows_the_wall_clock_and_drops_torques_without_commands(graph, swimmer):
    started, factor = time.monotonic(), 0.2  # which any machine manages
    graph.start("simulation", mode="real_time", real_time_factor=factor, command_timeout=0.3)
    robot = Robot(graph, swimmer)
    begin = graph.spin_until(lambda: robot.states and robot.states[-1])
    begun = time.monotonic()
    robot.command([1.0, 1.0], begin)
    graph.diagnosis("simulation", DiagnosticStatus.ERROR, "the torques are zero")

    def simulated():
        return 1e-9 * nanoseconds(robot.states[-1].header.stamp)

    def keeps_up():
        wall, since = time.monotonic() - begun, 1e-9 * nanoseconds(begin.header.stamp)
        return wall > 1.0 and simulated() - since > 0.5 * factor * wall

    graph.spin_until(keeps_up, what="the simulation to keep up with the wall clock")
    assert simulated() <= factor * (time.monotonic() - started)

    def answer(message):
        robot.command([1.0, 1.0], message)

    graph.node.create_subscription(JointState, "joint_states", answer, STREAM)
    graph.diagnosis("simulation", DiagnosticStatus.OK)


def test_in_real_time_a_torque_that_is_held_too_long_is_an_error(graph, swimmer):
    graph.start("simulation", mode="real_time", command_timeout=60.0)
    robot = Robot(graph, swimmer)
    robot.command([1.0, 1.0], graph.spin_until(lambda: robot.states and robot.states[-1]))
    sentence = "A command was held for 10 control steps"
    status = graph.diagnosis("simulation", DiagnosticStatus.ERROR, sentence)
    first = len(robot.states)
    graph.spin_until(lambda: len(robot.states) > first + 100)
    status = graph.diagnosis("simulation", DiagnosticStatus.ERROR, sentence)
    values = values_of(status)
    held, steps = map(int, values["overruns"].split(" of "))
    assert 60 < held <= steps
    assert "steps" in values["command age"]
    answer = lambda message: robot.command([1.0, 1.0], message)  # noqa: E731
    graph.node.create_subscription(JointState, "joint_states", answer, STREAM)
    graph.diagnosis("simulation", DiagnosticStatus.OK)


def test_in_real_time_an_old_command_is_refused_also_after_a_reset(graph, swimmer):
    graph.start("simulation", mode="real_time", command_timeout=0.3)
    robot = Robot(graph, swimmer)

    def commanded_after(duration):
        """Answers the state of a while ago [simulated s]."""
        first = len(robot.states)
        graph.spin_until(lambda: len(robot.states) > first)
        answered = robot.states[first]
        end = nanoseconds(answered.header.stamp) + round(1e9 * duration)
        graph.spin_until(lambda: nanoseconds(robot.states[-1].header.stamp) >= end)
        robot.command([1.0, 1.0], answered)

    def moves():
        return any(robot.states[-1].effort)

    for _ in range(2):
        commanded_after(1.0)
        graph.diagnosis("simulation", DiagnosticStatus.ERROR, "it must be that of the state")
        assert not moves()
        commanded_after(0.0)
        graph.spin_until(moves)
        # The torques end with the command's time, and with a reset at once.
        graph.spin_until(lambda: not moves())
        commanded_after(0.0)
        graph.spin_until(moves)
        graph.call(ResetSimulation, "simulation/reset_simulation")
        robot.states.clear()
        graph.spin_until(lambda: robot.states and robot.states[-1].header.stamp.sec == 0)
        assert not moves()


@EACH_SIGNAL
def test_two_signals_end_it_with_code_0_even_while_it_steps(graph, number):
    process = graph.start("simulation", start_paused=True)
    request = StepSimulation.Request(steps=5)
    graph.call_async(StepSimulation, "simulation/step_simulation", request)
    graph.spin_for(0.2)
    process.send(number)
    assert process.end(number) == 0, process.output
