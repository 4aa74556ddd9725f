# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Calls that come all at once: each is answered, up to the number that the documentation names."""

import pytest
from builtin_interfaces.msg import Time
from rclpy.action import ActionClient
from simulation_interfaces.srv import GetSimulationState
from vgps_msgs.action import TrainPolicy
from vgps_msgs.msg import SolveStatus
from vgps_msgs.srv import OptimizeTrajectory

from tests.nodes.conftest import PATIENCE
from vgps_ros.messages.optimization import request_to_msg
from vgps_ros.ros_runtime.qos import CALLS
from vgps_ros.search.optimization_request import first_request
from vgps_ros.tasks import make_task

pytestmark = pytest.mark.slow

AT_ONCE = 50
NAME = "trajectory_optimizer/optimize"


def call_at_once(graph, kind, name, request, count=AT_ONCE):
    """Returns the answers to calls of one client that are all sent before any is taken."""
    client = graph.node.create_client(kind, name, qos_profile=CALLS)
    graph.spin_until(client.service_is_ready)
    calls = [client.call_async(request) for _ in range(count)]
    graph.spin_until(lambda: all(call.done() for call in calls), PATIENCE, "all answers")
    return [call.result() for call in calls]


def test_a_service_answers_fifty_calls_at_once(graph):
    graph.start("simulation", task="rotor", start_paused=True)
    answers = call_at_once(
        graph, GetSimulationState, "simulation/get_simulation_state", GetSimulationState.Request()
    )
    assert {answer.result.result for answer in answers} == {1}


def test_an_optimizer_answers_fifty_requests_at_once(graph):
    graph.start("trajectory_optimizer", task="rotor")
    request = OptimizeTrajectory.Request(task="swimmer")
    answers = call_at_once(graph, OptimizeTrajectory, NAME, request)
    assert {answer.outcome.code for answer in answers} == {SolveStatus.REFUSED}


def test_an_optimizer_refuses_what_has_no_place_and_solves_the_rest(graph):
    graph.start("trajectory_optimizer", task="swimmer")
    task = make_task("swimmer")
    request = request_to_msg(first_request(task, 0, 1), task, Time())
    clients = [graph.node.create_client(OptimizeTrajectory, NAME, qos_profile=CALLS) for _ in "ab"]
    graph.spin_until(lambda: all(client.service_is_ready() for client in clients))
    calls = []
    for client in clients:
        calls += [client.call_async(request) for _ in range(CALLS.depth - 20)]
        graph.spin_for(1.0)
    graph.spin_until(lambda: all(call.done() for call in calls), PATIENCE, "all answers")
    answers = [call.result() for call in calls]
    refused = [each for each in answers if each.outcome.code == SolveStatus.REFUSED]
    assert all("100 requests wait already" in answer.message for answer in refused)
    assert 0 < len(refused) < CALLS.depth


def test_a_learner_answers_fifty_goals_at_once_and_takes_one(graph):
    graph.start("policy_learner", task="rotor")  # without an optimizer its training lasts
    client = ActionClient(
        graph.node, TrainPolicy, "policy_learner/train", goal_service_qos_profile=CALLS
    )
    graph.spin_until(client.server_is_ready)
    goals = [client.send_goal_async(TrainPolicy.Goal()) for _ in range(AT_ONCE)]
    graph.spin_until(lambda: all(goal.done() for goal in goals), PATIENCE, "all answers")
    assert sum(goal.result().accepted for goal in goals) == 1
    client.destroy()
