# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The optimizer's service: what it refuses, how it is cancelled, what it reports."""

import math
from array import array
from copy import deepcopy

import numpy as np
import pytest
from vgps_msgs.msg import OptimizerIteration, RobotModel, SolveStatus, Trajectory
from vgps_msgs.srv import CancelOptimization, OptimizeTrajectory

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.messages.conversions import pack, policy_to_msg
from vgps_ros.tasks import make_task

NODE = "trajectory_optimizer"
OBSERVED = make_task("swimmer").observation.names


@pytest.fixture(scope="module")
def optimizer(shared_graph):
    return shared_graph.start(NODE)


@pytest.fixture
def request_message(swimmer):
    guess = swimmer.begin.controls(swimmer, 500, generator(0, Stream.INITIAL_CONTROLS, 0))
    return OptimizeTrajectory.Request(
        task="swimmer",
        cost_scale=1.0,
        max_iterations=2,
        initial_state=pack(swimmer.initial_state),
        guess=[Trajectory(n_x=10, n_u=2, controls=pack(guess))],
    )


def other_policy(stamp, n_u=2, observed=OBSERVED):
    shape = Architecture(observed=observed, hidden_units=(2,), control_dim=n_u)
    policy = GaussianPolicy(shape, np.zeros(shape.num_parameters), np.ones(shape.control_dim))
    return policy_to_msg(policy, "swimmer", 0, stamp)


def test_a_solve_lowers_the_cost_and_logs_it(shared_graph, optimizer, request_message):
    response = shared_graph.call(OptimizeTrajectory, f"{NODE}/optimize", request_message)
    assert response.success, response.message
    assert response.outcome.code == SolveStatus.ITERATION_LIMIT
    costs = [iteration.cost for iteration in response.iterations]
    assert len(costs) == 2
    assert costs[1] < costs[0]
    assert response.cost == response.modified_cost == costs[1]
    assert len(response.distribution.gains) == 500 * 2 * 10


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"task": "runner"}, "'runner', but this optimizer solves 'swimmer'"),
        ({"robot": RobotModel(digest="0" * 64)}, "The request is for another model: its digest"),
        ({"robot": RobotModel(controls=["hip", "knee"])}, "its controls[0] is 'hip', but here it"),
        ({"cost_scale": 0.0}, "cost_scale is 0.0, but it must be finite and above 0"),
        ({"cost_scale": -1.0}, "cost_scale is -1.0"),
        ({"cost_scale": math.nan}, "cost_scale is nan"),
        ({"max_iterations": 0}, "max_iterations is 0"),
        ({"initial_state": array("d", [0.0] * 9)}, "initial_state has 9 values"),
        ({"initial_state": array("d", [math.nan] * 10)}, "initial_state is nan at index 0"),
        ({"initial_state": array("d", [1e300] * 10)}, "diverges"),
        ({"guess": [Trajectory(controls=array("d", [0.0] * 4))]}, "guess.controls has 4 values"),
    ],
)
def test_bad_requests_are_refused_with_a_sentence(
    shared_graph, optimizer, request_message, change, sentence
):
    for name, value in change.items():
        setattr(request_message, name, value)
    response = shared_graph.call(OptimizeTrajectory, f"{NODE}/optimize", request_message)
    assert not response.success
    expected = SolveStatus.DIVERGED if sentence == "diverges" else SolveStatus.REFUSED
    assert response.outcome.code == expected
    assert sentence in response.message
    assert optimizer.running


def test_policies_that_do_not_fit_are_refused(shared_graph, optimizer, request_message):
    stamp = shared_graph.node.get_clock().now().to_msg()
    solved = shared_graph.call(OptimizeTrajectory, f"{NODE}/optimize", request_message)
    cases = {
        "The policy has 3 controls": other_policy(stamp, n_u=3),
        "The policy reads ['tail/position']": other_policy(stamp, observed=("tail/position",)),
        "parameters has 1 values": other_policy(stamp),
        "noise_std is nan": other_policy(stamp),
    }
    cases["parameters has 1 values"].parameters = array("d", [0.0])
    cases["noise_std is nan"].noise_std = array("d", [math.nan, 1.0])
    request_message.policy = [other_policy(stamp)]
    alone = shared_graph.call(OptimizeTrajectory, f"{NODE}/optimize", request_message)
    assert "no previous distribution" in alone.message
    request_message.previous = [solved.distribution]
    for sentence, message in cases.items():
        request_message.policy = [message]
        response = shared_graph.call(OptimizeTrajectory, f"{NODE}/optimize", request_message)
        assert sentence in response.message
        assert response.outcome.code == SolveStatus.REFUSED


def test_a_running_solve_reports_and_can_be_cancelled(shared_graph, optimizer, request_message):
    iterations = shared_graph.messages(OptimizerIteration, f"{NODE}/iterations")
    request_message.max_iterations = 100_000
    future = shared_graph.call_async(OptimizeTrajectory, f"{NODE}/optimize", request_message)
    shared_graph.spin_until(lambda: len(iterations) >= 3, what="iterations while it runs")
    assert not future.done()
    assert shared_graph.call(CancelOptimization, f"{NODE}/cancel").success
    shared_graph.spin_until(future.done, what="the cancelled answer")
    assert not future.result().success
    assert future.result().outcome.code == SolveStatus.CANCELLED
    assert not shared_graph.call(CancelOptimization, f"{NODE}/cancel").success


def test_a_cancellation_names_the_request_that_it_cancels(shared_graph, optimizer, request_message):
    """Requests that are not named go on; one that waits is answered at once."""

    def asked(first, iterations):
        message = deepcopy(request_message)
        message.request_id.uuid[0], message.max_iterations = first, iterations
        return shared_graph.call_async(OptimizeTrajectory, f"{NODE}/optimize", message)

    def cancel(first):
        request = CancelOptimization.Request()
        request.request_id.uuid[0] = first
        return shared_graph.call(CancelOptimization, f"{NODE}/cancel", request)

    def code(future):
        shared_graph.spin_until(future.done, what="an answer")
        return future.result().outcome.code

    iterations = shared_graph.messages(OptimizerIteration, f"{NODE}/iterations")
    running, waiting, last = asked(1, 100_000), asked(2, 100_000), asked(3, 1)
    shared_graph.spin_until(lambda: len(iterations) >= 3, what="iterations while it runs")
    assert {i.request_id.uuid[0] for i in iterations} == {1}
    unknown = cancel(9)
    assert not unknown.success
    assert "No request 0900" in unknown.message
    assert [each.uuid[0] for each in cancel(2).cancelled] == [2]
    assert code(waiting) == SolveStatus.CANCELLED
    assert not running.done()
    assert cancel(1).success
    assert code(running) == SolveStatus.CANCELLED
    assert code(last) == SolveStatus.ITERATION_LIMIT
    both = asked(4, 100_000), asked(5, 100_000)
    shared_graph.spin_for(0.5)
    assert len(cancel(0).cancelled) == 2
    assert [code(each) for each in both] == [SolveStatus.CANCELLED] * 2


def test_a_termination_ends_a_running_solve(graph, request_message):
    node = graph.start(NODE)
    iterations = graph.messages(OptimizerIteration, f"{NODE}/iterations")
    request_message.max_iterations = 100_000
    answers = [
        graph.call_async(OptimizeTrajectory, f"{NODE}/optimize", request_message) for _ in range(2)
    ]
    # So many that the node has discovered who waits for its answers.
    graph.spin_until(lambda: len(iterations) > 30, what="a running solve")
    node.send(15)
    node.send(15)
    graph.spin_until(lambda: all(a.done() for a in answers), what="answers of a node that ends")
    assert [answer.result().outcome.code for answer in answers] == [SolveStatus.SHUTTING_DOWN] * 2
    assert node.wait() == 0, node.output
    assert "Traceback" not in node.output
