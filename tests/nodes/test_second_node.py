# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A node that would publish what another one of the graph publishes already ends at its start."""

from diagnostic_msgs.msg import DiagnosticStatus
from simulation_interfaces.srv import GetSimulationState


def test_a_second_node_that_would_do_the_same_is_refused(graph):
    kept = graph.start("mpc")
    graph.diagnosis("mpc", DiagnosticStatus.OK)
    refused = graph.start("policy_executor")
    assert refused.wait() == 1
    assert "/mpc publishes /joint_command already" in refused.output
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
