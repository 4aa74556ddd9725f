# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A node that would publish what another one of the graph publishes already ends at its start."""

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from simulation_interfaces.srv import GetSimulationState


@pytest.mark.parametrize(
    ("first", "second", "topic"),
    [
        pytest.param(*("policy_learner",) * 2, "learning_progress", marks=pytest.mark.slow),
        ("mpc", "policy_executor", "joint_command"),
    ],
)
def test_a_second_node_that_would_do_the_same_is_refused(graph, first, second, topic):
    kept = graph.start(first)
    graph.diagnosis(first, DiagnosticStatus.OK)
    refused = graph.start(second)
    assert refused.wait() == 1
    assert f"/{first} publishes /{topic} already" in refused.output
    assert "callback" not in refused.output  # of rclpy's words about errors in the code
    assert kept.running


def test_one_that_was_killed_can_be_started_again_at_once(graph):
    killed = graph.start("simulation")
    graph.diagnosis("simulation", DiagnosticStatus.OK)
    killed.kill()
    again = graph.start("simulation")
    graph.diagnosis("simulation", DiagnosticStatus.OK)
    graph.spin_for(3.0)  # in which it would be refused, were the killed one taken for alive
    assert again.running
    assert graph.call(GetSimulationState, "simulation/get_simulation_state").result.result == 1
