"""Requests and results of the trajectory optimizer to messages and back."""

from builtin_interfaces.msg import Time
from vgps_msgs.msg import OptimizerIteration, Trajectory
from vgps_msgs.msg import TrajectoryDistribution as TrajectoryDistributionMsg
from vgps_msgs.srv import OptimizeTrajectory

from vgps_ros.core.checks import finite_array, one_of, quoted
from vgps_ros.core.ddp import Iteration, Status
from vgps_ros.core.errors import DivergenceError, InvalidInputError, VgpsError
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.messages.conversions import (
    distribution_from_msg,
    distribution_to_msg,
    pack,
    policy_from_msg,
    policy_to_msg,
)
from vgps_ros.search.trajectory_optimization import (
    OptimizationRequest,
    OptimizationResult,
    check_distribution,
)
from vgps_ros.tasks import Task

ENDING = "ending"  # status of an answer by a node that ends before the solve does

# How a solve may end with a q(ζ) and still not well, and what helps.
TROUBLE = {
    Status.NO_DESCENT: "No step lowers the cost: start from other controls, or lower "
    "ddp.acceptance_ratio.",
    Status.INDEFINITE_QUU: "Quu is not positive definite up to ddp.regularization_limit: raise it, "
    "or give controls more weight in the cost.",
}


def request_to_msg(
    request: OptimizationRequest, task: Task, stamp: Time
) -> OptimizeTrajectory.Request:
    """Returns the request as a message."""
    n_x, n_u = task.dynamics.state_dim, task.dynamics.control_dim
    message = OptimizeTrajectory.Request(
        task=task.name,
        trajectory_index=request.trajectory_index,
        iteration=request.iteration,
        seed=request.seed,
        cost_scale=request.cost_scale,
        max_iterations=request.max_iterations,
        initial_state=pack(request.initial_state),
    )
    if request.guess is not None:
        message.guess = [Trajectory(n_x=n_x, n_u=n_u, controls=pack(request.guess))]
    if request.previous is not None:
        place = (request.trajectory_index, max(request.iteration - 1, 0))
        message.previous = [_distribution(request.previous, task, place, stamp)]
    if request.policy is not None:
        message.policy = [policy_to_msg(request.policy, task.name, request.iteration, stamp)]
    return message


def request_from_msg(message: OptimizeTrajectory.Request, task: Task) -> OptimizationRequest:
    """Returns the message's request.

    Raises:
        InvalidInputError: it is for another task, or a value does not fit.
    """
    if message.task != task.name:
        raise InvalidInputError(
            f"The request is for the task {quoted(message.task)}, but this optimizer solves "
            f"'{task.name}'."
        )
    shape = (task.planned_horizon, task.dynamics.control_dim)
    return OptimizationRequest(
        trajectory_index=message.trajectory_index,
        iteration=message.iteration,
        seed=message.seed,
        cost_scale=message.cost_scale,
        max_iterations=message.max_iterations,
        initial_state=finite_array(
            "initial_state", message.initial_state, (task.dynamics.state_dim,)
        ),
        guess=finite_array("guess.controls", message.guess[0].controls, shape)
        if message.guess
        else None,
        previous=distribution_from_msg(message.previous[0]) if message.previous else None,
        policy=policy_from_msg(message.policy[0]) if message.policy else None,
    )


def iteration_to_msg(
    iteration: Iteration, request: OptimizationRequest, stamp: Time
) -> OptimizerIteration:
    """Returns one entry of a solve's log as a message."""
    message = OptimizerIteration(
        trajectory_index=request.trajectory_index,
        search_iteration=request.iteration,
        iteration=iteration.index,
        cost=iteration.cost,
        cost_reduction=iteration.cost_reduction,
        expected_reduction=iteration.expected_reduction,
        step_size=iteration.step_size,
        regularization=iteration.regularization,
    )
    message.header.stamp = stamp
    return message


def result_to_msg(
    result: OptimizationResult, request: OptimizationRequest, task: Task, stamp: Time
) -> OptimizeTrajectory.Response:
    """Returns a result as the service's response."""
    return OptimizeTrajectory.Response(
        success=result.status is not Status.CANCELLED,
        status=result.status.value,
        message=_sentence(result),
        cost=result.cost,
        modified_cost=result.modified_cost,
        distribution=_distribution(
            result.distribution, task, (request.trajectory_index, request.iteration), stamp
        ),
        iterations=[iteration_to_msg(i, request, stamp) for i in result.iterations],
        simulator_steps=result.simulator_steps,
    )


def _sentence(result: OptimizationResult) -> str:
    """What a solve ended with, and what can be done where it is trouble."""
    words = [
        f"The solve ended after {len(result.iterations)} iterations: "
        f"{result.status.value.replace('_', ' ')}."
    ]
    if result.status in TROUBLE:
        words.append(TROUBLE[result.status])
    if result.simulator_warnings:
        words.append(f"MuJoCo warned of {result.simulator_warnings}.")
    return " ".join(words)


def result_from_msg(
    message: OptimizeTrajectory.Response, request: OptimizationRequest, task: Task
) -> OptimizationResult:
    """Returns the response's result.

    Args:
        message: the answer.
        request: what was asked for.
        task: the task.

    Raises:
        DivergenceError: the solve left the finite numbers.
        VgpsError: the request was refused, the solve was cancelled, or the answer is none that an
            optimizer gives.
    """
    if not message.success:
        sentence = f"The trajectory optimizer answered '{message.status}': {message.message}"
        if message.status in DivergenceError.STATUSES:
            raise DivergenceError(sentence, message.status)
        raise VgpsError(sentence)
    costs = finite_array("costs", [message.cost, message.modified_cost], (2,))
    distribution = distribution_from_msg(message.distribution)
    check_distribution("distribution", distribution, task, request.initial_state)
    return OptimizationResult(
        distribution=distribution,
        cost=float(costs[0]),
        modified_cost=float(costs[1]),
        status=Status(one_of("status", message.status, [status.value for status in Status])),
        iterations=tuple(
            Iteration(
                index=i.iteration,
                cost=i.cost,
                cost_reduction=i.cost_reduction,
                expected_reduction=i.expected_reduction,
                step_size=i.step_size,
                regularization=i.regularization,
            )
            for i in message.iterations
        ),
        simulator_steps=message.simulator_steps,
    )


def _distribution(
    q: TrajectoryDistribution, task: Task, place: tuple[int, int], stamp: Time
) -> TrajectoryDistributionMsg:
    return distribution_to_msg(
        q,
        task=task.name,
        trajectory_index=place[0],
        iteration=place[1],
        time_step=task.dynamics.time_step,
        stamp=stamp,
    )
