# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A response waits for a client that discovery shows only later, and nobody waits for it."""

import warnings

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from simulation_interfaces.srv import GetSimulationState
from std_srvs.srv import Trigger

from vgps_ros.ros_runtime.services import keep_responses


def answer(_, response):
    response.success = True
    return response


@pytest.mark.parametrize("failures", [0, 1, 2])
def test_a_response_without_a_client_is_sent_again(graph, failures):
    service = graph.node.create_service(Trigger, "answer", answer)
    send, tries = service.send_response, []

    def send_in_vain_first(response, header):
        tries.append(header)
        if len(tries) <= failures:
            warnings.warn("failed to send response (timeout)", RuntimeWarning, stacklevel=1)
        else:
            send(response, header)

    service.send_response = send_in_vain_first
    keep_responses(graph.node)
    assert graph.call(Trigger, "answer").success
    assert len(tries) == failures + 1


def test_a_client_that_no_response_can_reach_is_given_up(graph):
    node = graph.start("simulation", start_paused=True)
    wants_more_than_there_is = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    service = "simulation/get_simulation_state"
    client = graph.node.create_client(
        GetSimulationState, service, qos_profile=wants_more_than_there_is
    )
    unanswered = []

    def ask() -> bool:
        unanswered.append(client.call_async(GetSimulationState.Request()))
        graph.spin_for(1.0)
        return f"A response of /{service} is lost" in node.output

    graph.spin_until(ask)
    assert not any(future.done() for future in unanswered)
    assert graph.call(GetSimulationState, service).result.result
