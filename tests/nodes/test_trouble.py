# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Numerical trouble has a name in the response, on /diagnostics and in the log."""

from dataclasses import replace

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import StepSimulation
from unique_identifier_msgs.msg import UUID
from vgps_msgs.msg import SolveStatus, Trajectory
from vgps_msgs.srv import OptimizeTrajectory

from tests.nodes.conftest import values_of
from vgps_ros.core.ddp.solve import Status
from vgps_ros.core.errors import VgpsError
from vgps_ros.messages.conversions import command_to_msg, outcome_of, pack, stamp_of
from vgps_ros.messages.optimization import result_to_msg
from vgps_ros.ros_runtime.health import Health
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.tasks import make_task

ERROR, OK = DiagnosticStatus.ERROR, DiagnosticStatus.OK
NODE = "trajectory_optimizer"
ROTOR = make_task("rotor")


@pytest.fixture(scope="module")
def optimizer(shared_graph):
    return shared_graph.start(NODE, task="rotor")


@pytest.mark.parametrize(
    ("status", "change", "advice"),
    [
        ("diverged", {"controls": 1e8}, "start from smaller controls"),
        ("infinite_cost", {"cost_scale": 1e308}, "lower alpha"),
        ("exploding_marginals", {"cost_scale": 1e-30}, "Raise alpha"),
        ("indefinite_quu", {"cost_scale": 5e-324}, "raise"),
    ],
)
def test_a_solve_that_fails_has_a_named_status(shared_graph, optimizer, status, change, advice):
    controls = np.full((50, 1), change.get("controls", 1.0))
    request = OptimizeTrajectory.Request(
        task="rotor",
        cost_scale=change.get("cost_scale", 1.0),
        max_iterations=2**32 - 1,
        initial_state=pack(ROTOR.initial_state),
        guess=[Trajectory(n_x=2, n_u=1, controls=pack(controls))],
    )
    response = shared_graph.call(OptimizeTrajectory, f"{NODE}/optimize", request)
    assert not response.success
    assert response.outcome == outcome_of(status)
    assert advice in response.message
    found = shared_graph.diagnosis(NODE, DiagnosticStatus.ERROR, response.message)
    assert ("last status", status) in [(value.key, value.value) for value in found.values]
    shared_graph.spin_until_output(optimizer, response.message)
    assert "Traceback" not in optimizer.output


def test_a_solve_without_descent_says_what_helps():
    request = first_request(ROTOR, 0, 1)
    found = replace(optimize(ROTOR, request), status=Status.NO_DESCENT)
    response = result_to_msg(found, request, UUID(), ROTOR, Time())
    assert response.success
    assert response.outcome.code == SolveStatus.NO_DESCENT
    assert "No step lowers the cost: start from other controls." in response.message


def test_the_simulation_tells_what_mujoco_warns_of(graph, swimmer):
    start = [1e3] * 5 + [9e3] * 5
    node = graph.start("simulation", start_paused=True, initial_state=start)
    commands = graph.publisher(JointState, "joint_command")
    step = graph.call_async(
        StepSimulation, "simulation/step_simulation", StepSimulation.Request(steps=1)
    )
    graph.spin_until_output(node, "Waiting for joint_command")  # it steps
    torques = np.array([1e8, -1e8])
    commands.publish(command_to_msg(torques, swimmer.controls, stamp_of(0)))
    graph.spin_until(step.done)
    status = graph.diagnosis("simulation", DiagnosticStatus.ERROR, "diverged")
    assert values_of(status)["MuJoCo warnings"] == "bad acceleration (1)"
    graph.spin_until_output(node, "MuJoCo warns of bad acceleration (1)")


def test_only_an_error_that_was_not_foreseen_leaves_its_traceback(graph):
    health, lines = Health(graph.node), graph.messages(Log, "/rosout")
    assert health.sentence_of(VgpsError("Name another task.")) == "Name another task."
    with pytest.raises(ZeroDivisionError) as caught:
        divmod(1, 0)
    sentence = health.sentence_of(caught.value)
    assert sentence.startswith("ZeroDivisionError: ")
    graph.spin_until(lambda: any("divmod(1, 0)" in x.msg for x in lines), what="the traceback")
    assert not any("another task" in line.msg for line in lines)


def test_a_fault_that_is_over_is_gone_from_the_next_diagnostics(graph):
    health, array = Health(graph.node), graph.messages(DiagnosticArray, "/diagnostics")
    graph.spin_until(lambda: array, what="diagnostics")
    health.report("state", error="It fell.")
    health.clear("state")
    levels = []

    def are_three():
        levels.extend(status.level for message in array for status in message.status)
        array.clear()
        return ERROR in levels and len(levels[levels.index(ERROR) :]) == 3

    graph.spin_until(are_three, what="the fault and two more")
    assert levels[levels.index(ERROR) :] == [ERROR, OK, OK]
