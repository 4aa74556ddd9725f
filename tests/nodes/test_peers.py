# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What nodes notice of each other: one that dies, hangs, leaves, or is one too many."""

import signal
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from simulation_interfaces.srv import GetSimulationState

NOTICED = 5.0  # what docs/explanation/reliability.md promises [s]
SILENT = "/trajectory_optimizer has been silent for over 3 s: it was killed, or it hangs."


@pytest.fixture
def simulation(graph):
    return graph.start("simulation", start_paused=True)


@pytest.fixture
def pair(graph, simulation):
    """A simulation that has heard an optimizer, and the optimizer."""
    optimizer = graph.start("trajectory_optimizer")
    graph.diagnosis("trajectory_optimizer", DiagnosticStatus.OK)
    graph.spin_for(1.5)
    return optimizer


def test_a_killed_node_is_noticed_and_its_return_too(graph, pair):
    pair.kill()
    status = graph.diagnosis("simulation", DiagnosticStatus.WARN, timeout=NOTICED)
    assert status.message == SILENT
    graph.start("trajectory_optimizer")
    graph.diagnosis("simulation", DiagnosticStatus.OK)


def test_a_stopped_node_is_noticed_and_takes_no_one_for_dead_when_it_goes_on(graph, pair):
    pair.send(signal.SIGSTOP)
    try:
        status = graph.diagnosis("simulation", DiagnosticStatus.WARN, timeout=NOTICED)
        assert status.message == SILENT
    finally:
        pair.send(signal.SIGCONT)
    graph.diagnosis("simulation", DiagnosticStatus.OK)
    assert graph.diagnosis("trajectory_optimizer", DiagnosticStatus.OK).message == "Running."
    assert "silent" not in pair.output


def test_a_stopped_node_is_noticed_in_time_by_one_that_was_held_up_meanwhile(
    graph, simulation, pair
):
    """As the middleware does, for two seconds, where a node is stopped while it holds a lock."""
    began = time.monotonic()
    pair.send(signal.SIGSTOP)
    simulation.send(signal.SIGSTOP)
    try:
        graph.spin_for(2.0)
        simulation.send(signal.SIGCONT)
        left = NOTICED - (time.monotonic() - began)
        status = graph.diagnosis("simulation", DiagnosticStatus.WARN, timeout=left)
        assert status.message == SILENT
    finally:
        pair.send(signal.SIGCONT)
    graph.diagnosis("simulation", DiagnosticStatus.OK)


def test_a_node_that_was_stopped_for_long_takes_no_one_for_dead(graph, simulation, pair):
    simulation.send(signal.SIGSTOP)
    graph.spin_for(NOTICED)
    simulation.send(signal.SIGCONT)
    graph.spin_for(3.0)
    assert "silent" not in simulation.output
    assert pair.running


def test_a_node_that_ends_properly_is_missed_by_no_one(graph, pair):
    assert pair.end() == 0
    graph.spin_for(NOTICED)
    assert graph.diagnosis("simulation", DiagnosticStatus.OK).message == "Running."


@pytest.mark.parametrize(
    ("first", "second", "topic"),
    [
        ("policy_learner", "policy_learner", "learning_progress"),
        ("policy_executor", "demonstration", "joint_command"),
        ("mpc", "policy_executor", "joint_command"),
    ],
)
def test_a_second_node_that_would_do_the_same_is_refused(graph, first, second, topic):
    kept = graph.start(first)
    graph.diagnosis(first, DiagnosticStatus.OK)
    refused = graph.start(second)
    assert refused.wait() == 1
    assert f"/{first} (process " in refused.output
    assert f"publishes /{topic} already" in refused.output
    assert "callback" not in refused.output  # of rclpy's words about errors in the code
    assert kept.running


def test_of_two_executors_started_at_once_one_stays_and_nobody_misses_the_other(graph):
    graph.start("simulation", start_paused=True)
    both = [graph.start("policy_executor") for _ in range(2)]
    graph.spin_until(lambda: not all(process.running for process in both), what="a refusal")
    graph.spin_for(NOTICED)
    assert sum(process.running for process in both) == 1
    graph.diagnosis("simulation", DiagnosticStatus.OK)


def test_nobody_ends_for_one_that_only_claims_to_publish(graph):
    graph.start("simulation", start_paused=True)
    executor = graph.start("policy_executor")
    graph.diagnosis("simulation", DiagnosticStatus.OK)
    graph.diagnosis("policy_executor", DiagnosticStatus.OK)
    claim = DiagnosticStatus(name="/simulation", hardware_id="vgps_ros", message="Running.")
    claim.values = [
        KeyValue(key="instance", value="1-here-1"),  # it says that it was there first
        KeyValue(key="owns", value="/joint_command"),
    ]
    graph.publisher(DiagnosticArray, "/diagnostics").publish(DiagnosticArray(status=[claim]))
    graph.spin_for(2.0)
    assert executor.running, executor.output


def test_one_that_was_killed_can_be_started_again_at_once(graph):
    killed = graph.start("simulation")
    graph.diagnosis("simulation", DiagnosticStatus.OK)
    killed.kill()
    again = graph.start("simulation")
    graph.diagnosis("simulation", DiagnosticStatus.OK)
    graph.spin_for(3.0)  # in which it would be refused, were the killed one taken for alive
    assert again.running
    assert graph.call(GetSimulationState, "simulation/get_simulation_state").result.result == 1
