# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Requests and results of the trajectory optimizer to messages and back."""

from uuid import uuid4

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.parameter import Parameter
from std_msgs.msg import Header
from unique_identifier_msgs.msg import UUID
from vgps_msgs.msg import Disturbance as DisturbanceMsg
from vgps_msgs.msg import OptimizerIteration, SolveStatus, Trajectory
from vgps_msgs.srv import OptimizeTrajectory

from vgps_ros.core.checks import finite_array, quote
from vgps_ros.core.ddp.solve import Iteration, Status
from vgps_ros.core.errors import DivergenceError, InvalidInputError, VgpsError
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.settings import settings_of, with_values
from vgps_ros.messages.conversions import (
    check_robot,
    distribution_from_msg,
    distribution_to_msg,
    from_message,
    outcome_of,
    pack,
    policy_from_msg,
    policy_to_msg,
    robot_of,
    to_message,
)
from vgps_ros.search.optimization_request import OptimizationRequest, check_distribution
from vgps_ros.search.situations import Situation
from vgps_ros.search.trajectory_optimization import OptimizationResult
from vgps_ros.tasks import Task
from vgps_ros.tasks.disturbance import Disturbance

# A solve's ends by the constants of the message.
_WITH_SOLUTION = {getattr(SolveStatus, s.name): s for s in Status if s is not Status.CANCELLED}
_DIVERGED = {getattr(SolveStatus, s.upper()): s for s in DivergenceError.STATUSES}

# How a solve may end with a q(ζ) and still not well, and what helps.
TROUBLE = {
    Status.NO_DESCENT: "No step lowers the cost: start from other controls.",
    Status.INDEFINITE_QUU: "Quu is not positive definite at the largest regularisation: give "
    "controls more weight in the cost.",
}


def request_to_msg(
    request: OptimizationRequest, task: Task, stamp: Time
) -> OptimizeTrajectory.Request:
    """Returns the request as a message, with a new identity by which it can be cancelled."""
    n_x, n_u, deployment = task.dims["n_x"], task.dims["n_u"], task.deployment
    robot = robot_of(deployment)
    guess, states, k = request.guess, request.guess_states, request.iteration
    previous, policy = request.previous, request.policy
    place = (request.trajectory_index, max(k - 1, 0))
    return to_message(
        OptimizeTrajectory.Request,
        request,
        request_id=UUID(uuid=np.frombuffer(uuid4().bytes, dtype=np.uint8)),
        task=task.name,
        robot=robot,
        context=pack(request.situation.context),
        disturbance=to_message(DisturbanceMsg, request.situation.disturbance),
        guess=[]
        if guess is None
        else [
            Trajectory(
                robot=robot,
                n_x=n_x,
                n_u=n_u,
                states=pack(np.empty(0) if states is None else states),
                controls=pack(guess),
            )
        ],
        previous=[distribution_to_msg(previous, deployment, *place, stamp)] if previous else [],
        policy=[policy_to_msg(policy, task.name, k, stamp, robot)] if policy else [],
    )


def request_from_msg(message: OptimizeTrajectory.Request, task: Task) -> OptimizationRequest:
    """Returns the message's request.

    Raises:
        InvalidInputError: it is for another task or robot, or a value does not fit.
    """
    if message.task != task.name:
        raise InvalidInputError(
            f"The request is for the task {quote(message.task)}, but this optimizer solves "
            f"'{task.name}'."
        )
    robots = {
        "The request": [message.robot],
        "The guess": [each.robot for each in message.guess],
        "The previous distribution": [each.mean.robot for each in message.previous],
        "The policy": [each.robot for each in message.policy],
    }
    own = robot_of(task.deployment)
    for what, given in robots.items():
        for robot in given:
            check_robot(what, robot, own)
    shape = (task.planned_horizon, task.dims["n_u"])
    of_states = (task.planned_horizon + 1, task.dims["n_x"])
    guess, start = message.guess, (task.dims["n_x"],)
    return from_message(
        OptimizationRequest,
        message,
        situation=Situation(
            finite_array("initial_state", message.initial_state, start),
            finite_array("context", message.context, (task.planned_horizon, task.dims["n_z"])),
            from_message(Disturbance, message.disturbance),
        ),
        guess=finite_array("guess.controls", guess[0].controls, shape) if guess else None,
        guess_states=finite_array("guess.states", guess[0].states, of_states)
        if guess and len(guess[0].states)
        else None,
        previous=distribution_from_msg(message.previous[0]) if message.previous else None,
        policy=policy_from_msg(message.policy[0]) if message.policy else None,
    )


def iteration_to_msg(
    iteration: Iteration, request: OptimizationRequest, request_id: UUID, stamp: Time
) -> OptimizerIteration:
    """Returns one entry of a solve's log as a message."""
    return to_message(
        OptimizerIteration,
        iteration,
        header=Header(stamp=stamp),
        request_id=request_id,
        trajectory_index=request.trajectory_index,
        search_iteration=request.iteration,
        iteration=iteration.index,
    )


def result_to_msg(
    result: OptimizationResult,
    request: OptimizationRequest,
    request_id: UUID,
    task: Task,
    stamp: Time,
) -> OptimizeTrajectory.Response:
    """Returns a result as the service's response."""
    place = (request.trajectory_index, request.iteration)
    return to_message(
        OptimizeTrajectory.Response,
        result,
        success=result.status is not Status.CANCELLED,
        outcome=outcome_of(result.status.value),
        message=_sentence(result),
        settings=[
            Parameter(s.name, value=s.default).to_parameter_msg()
            for s in settings_of(result.settings)
        ],
        distribution=distribution_to_msg(result.distribution, task.deployment, *place, stamp),
        iterations=[iteration_to_msg(i, request, request_id, stamp) for i in result.iterations],
    )


def _sentence(result: OptimizationResult) -> str:
    """Says how a solve ended, and what helps where it did not end well."""
    status = result.status.value.replace("_", " ")
    words = [f"The solve ended after {len(result.iterations)} iterations: {status}."]
    if result.status in TROUBLE:
        words.append(TROUBLE[result.status])
    if result.simulator_warnings:
        words.append(f"MuJoCo warned of {result.simulator_warnings}.")
    return " ".join(words)


def result_from_msg(
    message: OptimizeTrajectory.Response, request: OptimizationRequest, task: Task
) -> OptimizationResult:
    """Returns the response's result.

    Raises:
        DivergenceError: the solve left the finite numbers.
        VgpsError: the request was refused, the solve was cancelled, or the answer is none that an
            optimizer gives.
    """
    code = message.outcome.code
    if not message.success:
        sentence = f"The trajectory optimizer answered: {message.message}"
        if code in _DIVERGED:
            raise DivergenceError(sentence, _DIVERGED[code])
        raise VgpsError(sentence)
    if code not in _WITH_SOLUTION:
        raise InvalidInputError(
            f"outcome.code is {code}, but that of a solution must be one of "
            f"{list(_WITH_SOLUTION)}; start an optimizer of this version."
        )
    costs = finite_array("costs", [message.cost, message.modified_cost], (2,))
    check_robot("The distribution", message.distribution.mean.robot, robot_of(task.deployment))
    distribution = distribution_from_msg(message.distribution)
    check_distribution("distribution", distribution, task, request.initial_state)
    return OptimizationResult(
        situation=request.situation,
        distribution=distribution,
        cost=float(costs[0]),
        modified_cost=float(costs[1]),
        settings=_settings_from(message),
        status=_WITH_SOLUTION[code],
        iterations=tuple(from_message(Iteration, i, index=i.iteration) for i in message.iterations),
        simulator_steps=message.simulator_steps,
    )


def _settings_from(message: OptimizeTrajectory.Response) -> OptimizerSettings:
    """Returns the settings that an answer names, all of which it must name."""
    given = {one.name: Parameter.from_parameter_msg(one).value for one in message.settings}
    settings = OptimizerSettings()
    for setting in settings_of(settings):
        if setting.name not in given:
            raise InvalidInputError(
                f"The trajectory optimizer does not say by which {setting.name} it has solved: "
                "start one of this version."
            )
    return with_values(settings, given)
