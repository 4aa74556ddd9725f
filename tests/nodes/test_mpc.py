# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The node `mpc` in real processes: its motion, its faults and its end."""

import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from vgps_msgs.msg import Plan as PlanMsg

from tests.nodes.conftest import PATIENCE, Hardware, values_of
from vgps_ros.messages.conversions import nanoseconds, state_from_msg, trajectory_from_msg
from vgps_ros.search.mpc import MpcSettings, PlanFollower, Planner
from vgps_ros.tasks import make_task

PERIOD = 20_000_000  # of the swimmer's control [ns]
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def test_lock_step_through_two_processes_equals_the_same_loop_in_process(graph):
    steps, task = 30, make_task("swimmer")
    graph.start("mpc", horizon=0.4, plan_every=3, seed=1, wait_timeout=PATIENCE)
    received = graph.messages(JointState, "joint_states")
    plans = graph.messages(PlanMsg, "plan")
    graph.diagnosis("mpc", OK, "Waiting for joint_states")
    graph.start("simulation", start_paused=True, wait_timeout=PATIENCE)
    for _ in range(0, steps, 5):  # a few at a time: this process must keep up
        graph.step(5)
    states = {}

    def are_there():
        states.update({nanoseconds(s.header.stamp) // PERIOD: s for s in received})
        return len(states) == steps + 1

    graph.spin_until(are_there, what="all states")
    settings = MpcSettings(horizon=0.4, ddp=task.optimizer.ddp)
    horizon, x = PlanFollower(Planner(make_task("swimmer"), settings), 3, seed=1), None
    x = task.initial_state
    for step in range(steps):
        np.testing.assert_array_equal(state_from_msg(states[step], task.joint_names), x)
        x = task.dynamics.step(x, horizon.control(x, step)[0])
    horizon.stop()
    # Of each plan there is a message, whose motion begins where the robot was. The last one may
    # come after the torques that it gave.
    graph.spin_until(lambda: len(plans) == steps // 3, what="all plans")
    assert [nanoseconds(p.header.stamp) // PERIOD for p in plans] == list(range(0, steps, 3))
    planned = trajectory_from_msg(plans[4].trajectory)
    np.testing.assert_array_equal(planned.states[0], state_from_msg(states[12], task.joint_names))
    assert planned.horizon == 20


def test_the_costs_parameters_change_and_refuse_as_one(graph):
    node = graph.start("mpc", horizon=0.2)
    graph.diagnosis("mpc", OK, "Waiting for joint_states")
    assert graph.set_parameter("mpc", "cost.targets", [-1.0]).successful
    for name, values, sentence in (
        ("cost.targets", [1.0, 2.0], "2 values are given, but the cost has 1 readings"),
        ("cost.targets", [float("nan")], "cost.targets is nan"),
        ("cost.targets", [1e9], "cost.targets is 1000000000.0"),
        ("cost.weights", [-1.0], "cost.weights is -1.0, but it must be from 0"),
        ("cost.weights", [], "Wrong parameter type"),
        ("cost.readings", ["velocity/y"], "read-only"),
    ):
        answer = graph.set_parameter("mpc", name, values)
        assert not answer.successful
        assert sentence in answer.reason
    assert node.running


def test_a_reading_that_the_task_lacks_is_refused_at_start(graph):
    node = graph.start("mpc", cost__readings="[velocity/y]")
    assert node.wait() == 1
    assert "the task has ['velocity/x']; leave this parameter out." in node.output


def test_a_planner_that_is_killed_leaves_the_simulation_with_no_torques(graph):
    planner = graph.start("mpc", plan_every=0)
    graph.diagnosis("mpc", OK, "Waiting for joint_states")
    graph.start("simulation", mode="real_time", command_timeout=0.3)
    commands = graph.messages(JointState, "joint_command")
    states = graph.messages(JointState, "joint_states")
    graph.spin_until(lambda: len(commands) > 20, what="torques")
    values = values_of(graph.diagnosis("mpc", OK, "Running."))
    assert {"plan age", "plan cost", "plan duration", "missed deadlines"} <= values.keys()
    planner.kill()
    graph.diagnosis("simulation", ERROR, "No joint_command for 0.3 s, so the torques are zero")
    graph.spin_until(lambda: not np.any(states[-1].effort), what="states without torques")
    states.clear()
    graph.spin_until(lambda: len(states) > 5, what="the simulation to go on")
    assert not any(np.any(state.effort) for state in states)


def test_a_plan_that_diverges_ends_in_the_safe_action_and_a_sound_state_drives_again(graph):
    task = make_task("swimmer")
    graph.start("mpc", safe_action="zero", plan_age_limit=0.06)
    robot = Hardware(graph, task)
    graph.diagnosis("mpc", OK, "Waiting for joint_states")

    def answer(step, state):
        return robot.answer(state, step * PERIOD)

    assert answer(0, task.initial_state).any()
    wild = np.full(10, 9.9e3)
    answers = [answer(step, wild).any() for step in range(1, 8)]
    assert answers == [True] * 3 + [False] * 4  # the first plan may drive for three steps
    status = graph.diagnosis("mpc", ERROR, "the newest plan is")
    assert "a plan may drive for 3 steps only; no plan was found: " in status.message
    assert answer(8, task.initial_state).any()


@pytest.mark.parametrize(
    ("number", "moment"),
    [
        (signal.SIGTERM, "Compiling"),
        pytest.param(signal.SIGINT, "Waiting for joint_states", marks=pytest.mark.slow),
        (signal.SIGTERM, "driving"),
    ],
)
def test_a_signal_ends_it_at_any_moment(graph, number, moment):
    # A first plan that would take minutes, of which it must let go.
    long = {"first_iterations": 10_000, "horizon": 1.4} if moment == "Compiling" else {}
    node = graph.start("mpc", task="quadruped" if long else "swimmer", plan_every=0, **long)
    if moment == "Compiling":
        graph.spin_until(lambda: graph.node.get_node_names().count("mpc"), what="the node")
        graph.spin_for(1.0)
    else:
        graph.spin_until_output(node, "Waiting for joint_states")
    if moment == "driving":
        graph.start("simulation", mode="real_time")
        commands = graph.messages(JointState, "joint_command")
        graph.spin_until(lambda: len(commands) > 5, what="torques")
    assert node.end(number, timeout=20.0) == 0, node.output
