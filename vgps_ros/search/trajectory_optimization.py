# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Optimises q(ζ) by DDP and computes its marginals: lines 1, 3 and 6 of Algorithm 1.

An optimisation is a pure function of its request, so it gives the same numbers in this process, in
another one, or on another machine of the same kind.
"""

import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from vgps_ros.core.compilation import before_first_compilation
from vgps_ros.core.compiled_gaussians import pivoted_roots, propagate
from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.ddp.backward_pass import LocalPolicy, backward_pass
from vgps_ros.core.ddp.forward_pass import Problem
from vgps_ros.core.ddp.mean_derivatives import mean_derivatives
from vgps_ros.core.ddp.solve import COST_TOLERANCE, Iteration, Solution, Status, centre_of_q, solve
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.marginals import state_covariances
from vgps_ros.core.optimizer_settings import DdpSettings, OptimizerSettings
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.records import LinearDynamics, Trajectory, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.robot.executed_control import ExecutedPolicy
from vgps_ros.search.optimization_request import OptimizationRequest, check_request, initial_motion
from vgps_ros.search.situations import Situation
from vgps_ros.simulation.warnings import in_words
from vgps_ros.tasks import Task
from vgps_ros.tasks.task import Nominal

_SAMPLE_WIDTH = 0.3  # of samples for derivatives, as a factor on q's standard deviations


@dataclass(frozen=True)
class OptimizationResult:
    """The result of one solve.

    Attributes:
        situation: the situation that was solved.
        distribution: q(ζ).
        cost: Σ c of its mean over the scored horizon, unscaled and without the policy term.
        modified_cost: the cost that was minimised, Σ c̄ or Σ α c over the planned horizon.
        status: the reason why the solve ended.
        settings: the settings by which it was solved.
        iterations: the solver's log.
        simulator_steps: simulator steps that it took, finite differences included.
        simulator_warnings: MuJoCo's warnings meanwhile, in words; empty if there were none.
    """

    situation: Situation
    distribution: TrajectoryDistribution
    cost: float
    modified_cost: float
    status: Status
    settings: OptimizerSettings
    iterations: tuple[Iteration, ...]
    simulator_steps: int
    simulator_warnings: str = ""


def optimize(
    task: Task,
    request: OptimizationRequest,
    on_iteration: Callable[[Iteration], None] = lambda _: None,
    is_cancelled: Callable[[], bool] = lambda: False,
    start: Nominal | None = None,
) -> OptimizationResult:
    """Optimises q(ζ) with the settings that the task names.

    `start` is the request's first motion, where the caller has made it already. Whether to end is
    asked between the parts of each iteration.

    Raises:
        InvalidInputError: a value of the request does not fit the task.
        DivergenceError: the first rollout diverges, or the solve ends where q(ζ) would not be
            finite, as at an indefinite Quu; its status names the cause.
    """
    check_request(task, request)
    here = request.situation.of(task)
    warned_before = here.dynamics.warnings()
    told = task.in_context(request.situation.context)
    start = start or initial_motion(told, request, is_cancelled)
    if here.dynamics is not task.dynamics and request.previous is None:
        start = Nominal.guessed(start.trajectory, here.dynamics, start.simulator_steps)
    task = here
    scaled = ScaledCost(task.cost, request.cost_scale)
    cost: TrajectoryCost = scaled
    ddp = _scale_settings(task.optimizer.ddp, request.cost_scale)
    cost_tolerance, tolerance = COST_TOLERANCE, 0.0
    if request.policy and request.previous:
        place = (request.iteration, request.trajectory_index)
        rng = generator(request.seed, Stream.POLICY_DERIVATIVES, *place)
        q, count = request.previous, task.optimizer.policy_samples
        cost = PolicyCost.of(scaled, request.policy, task.observation, q, count, rng)
        tolerance = task.optimizer.bound_tolerance
    else:
        cost_tolerance = max(COST_TOLERANCE, task.optimizer.first_tolerance)
    solution = solve(
        task.dynamics,
        cost,
        start.trajectory,
        ddp,
        request.max_iterations,
        linear_dynamics=start.linear_dynamics,
        gaps=start.gaps,
        cost_tolerance=cost_tolerance,
        tolerance=tolerance,
        on_iteration=on_iteration,
        is_cancelled=is_cancelled,
    )
    q, steps = _distribution(task, request, cost, solution)
    return OptimizationResult(
        situation=request.situation,
        distribution=q,
        cost=task.trajectory_cost(solution.trajectory.first(task.horizon)),
        modified_cost=solution.cost,
        status=solution.status,
        settings=task.optimizer,
        iterations=solution.iterations,
        simulator_steps=start.simulator_steps + solution.simulator_steps + steps,
        simulator_warnings=in_words(task.dynamics.warnings() - warned_before),
    )


Outcome = OptimizationResult | DivergenceError
"""What becomes of a request; one that diverges says so, and leaves the others alone."""


def attempt(
    task: Task,
    request: OptimizationRequest,
    on_iteration: Callable[[Iteration], None] = lambda _: None,
) -> Outcome:
    """Returns the result of `optimize`, or the error of a solve that diverges."""
    try:
        return optimize(task, request, on_iteration)
    except DivergenceError as error:
        return error


def optimize_all(task: Task, requests: Sequence[OptimizationRequest]) -> list[Outcome]:
    """Solves several requests in this process, one after another."""
    return [attempt(task, request) for request in requests]


def _distribution(
    task: Task, request: OptimizationRequest, cost: TrajectoryCost, solution: Solution
) -> tuple[TrajectoryDistribution, int]:
    """Returns q(ζ) around a solve's trajectory, and the simulator steps that it took.

    Where its derivatives are means over samples, these are as wide as the q that follows from the
    derivatives at the trajectory itself.
    """
    settings, mean = task.optimizer, solution.trajectory
    q = _around(task, request, mean, solution.policy, solution.linear_dynamics)
    count, is_cancelled = settings.dynamics_samples, solution.status is Status.CANCELLED
    if not count or is_cancelled:
        return q, 0
    place = (request.iteration, request.trajectory_index)
    rng = generator(request.seed, Stream.DYNAMICS_DERIVATIVES, *place)
    linear, steps = mean_derivatives(task.dynamics, q, count, _SAMPLE_WIDTH, rng)
    problem, mu = Problem(task.dynamics, cost), _scale_settings(settings.ddp, request.cost_scale)
    policy = centre_of_q(problem, problem.around(mean, linear), mu.distribution_regularization)
    return _around(task, request, mean, policy, linear), steps


def _around(
    task: Task,
    request: OptimizationRequest,
    mean: Trajectory,
    policy: LocalPolicy,
    linear: LinearDynamics,
) -> TrajectoryDistribution:
    """Returns q(ζ) around a trajectory that was executed, with its marginals."""
    covariances, gains = policy.control_covariances(), policy.gains
    settings, alpha = task.optimizer.marginals, request.cost_scale
    spread = settings.spread(task.initial_std, task.std_limit, task.velocities, alpha)
    return TrajectoryDistribution(
        mean=mean,
        gains=gains,
        control_covariances=covariances,
        linear_dynamics=linear,
        state_covariances=state_covariances(linear, gains, covariances, spread),
        context=request.situation.context,
    )


def _scale_settings(settings: DdpSettings, alpha: float) -> DdpSettings:
    return replace(
        settings,
        initial_regularization=alpha * settings.initial_regularization,
        regularization_floor=alpha * settings.regularization_floor,
        distribution_regularization=alpha * settings.distribution_regularization,
    )


_NOTICE = "Compiling the numerical loops, once after an installation (about half a minute) ..."
# For a process that compiles one half of the loops; their types are the same for each task.
_SECOND_HALF = """
from vgps_ros.search.trajectory_optimization import run_second_half
from vgps_ros.tasks import make_task
run_second_half(make_task("rotor"))
"""


def prepare(task: Task) -> None:
    """Runs each compiled loop once, for one step.

    Only after an installation this takes long: then the loops are compiled, the derivatives' here
    and the others in a second process meanwhile, and their machine code is kept.
    """
    helpers = list[subprocess.Popen[bytes]]()

    def start_helper() -> None:
        words = [sys.executable, "-c", _SECOND_HALF]
        none = subprocess.DEVNULL
        helpers.append(subprocess.Popen(words, stdout=none, stderr=none))

    still = Trajectory(np.tile(task.initial_state, (2, 1)), np.zeros((1, task.dims["n_u"])))
    with before_first_compilation(partial(print, _NOTICE, flush=True)):
        try:
            with before_first_compilation(start_helper):
                task.dynamics.linearize(still)
            for helper in helpers:
                helper.wait()
        finally:
            for helper in helpers:
                helper.terminate()
        run_second_half(task)


def run_second_half(task: Task) -> None:
    """Runs each compiled loop once, but for the one of derivatives."""
    dynamics, n_x = task.dynamics, task.dynamics.space.tangent_dim
    motion = dynamics.rollout(task.initial_state, lambda *_: np.zeros(dynamics.control_dim), 1)
    linear = LinearDynamics(np.eye(n_x)[None], np.zeros((1, n_x, dynamics.control_dim)))
    local = backward_pass(linear, task.cost.expand(motion), 1.0)
    list(dynamics.follow_each(task.initial_state, [motion], local.gains))
    square = np.ones((1, n_x, n_x))
    propagate(square[0], square, square, np.ones(n_x), np.empty((2, n_x, n_x)))
    pivoted_roots(square, np.empty_like(square))
    shape = Architecture(task.observation.names, (1,), dynamics.control_dim)
    policy = GaussianPolicy(shape, np.zeros(shape.num_parameters), np.ones(dynamics.control_dim))
    ExecutedPolicy(policy)
    noise = np.zeros((1, 1, dynamics.control_dim))
    told = task.observation.within(np.zeros((1, task.dims["n_z"])))
    dynamics.execute(policy, told, motion.states[:1], noise)
    dynamics.replay(task.initial_state, motion.controls[None])
    readings = task.observation.readings
    readings.pull_back(np.eye(len(readings.names))[None], motion.states[:1])
    for read in (readings, task.fallen):
        read(motion.states)
    task.cost.values(motion)
