# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Lines 1, 3 and 6 of Algorithm 1: optimises q(ζ) by DDP and computes its marginals.

An optimisation is a pure function of its request, so it gives the same numbers in this process, in
another one, or on another machine of the same kind.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vgps_ros.core.checks import check_array, check_record, positive
from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.ddp.solve import Iteration, Solution, Status, solve
from vgps_ros.core.ddp.tracking import track
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.marginals import sample_deviations, state_covariances
from vgps_ros.core.optimizer_settings import DdpSettings, OptimizerSettings
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.records import Array, LinearDynamics, Trajectory, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.simulation.warnings import in_words
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class OptimizationRequest:
    """The input of one solve.

    Attributes:
        trajectory_index: index of the initial state in Algorithm 1.
        iteration: k of Algorithm 1; 0 for the initial solve.
        seed: seed of the run.
        cost_scale: α.
        max_iterations: largest number of DDP iterations.
        initial_state: x_1, shape (n_x,).
        guess: controls (T, n_u) to start from if there is no `previous`.
        guess_states: states (T+1, n_x) to start from with them, all but the first; they need not
            satisfy the dynamics. None: those of the controls' rollout.
        previous: q(ζ) of the iteration before.
        policy: π_θ; if it is None the cost is α c alone.
    """

    trajectory_index: int
    iteration: int
    seed: int
    cost_scale: float
    max_iterations: int
    initial_state: Array
    guess: Array | None = None
    guess_states: Array | None = None
    previous: TrajectoryDistribution | None = None
    policy: GaussianPolicy | None = None


@dataclass(frozen=True)
class OptimizationResult:
    """The result of one solve.

    Attributes:
        distribution: q(ζ).
        cost: Σ c of its mean over the scored horizon, unscaled and without the policy term.
        modified_cost: the cost that was minimised, Σ c̄ or Σ α c over the planned horizon.
        status: the reason why the solve ended.
        settings: the settings by which it was solved.
        iterations: the solver's log.
        simulator_steps: simulator steps that it took, finite differences included.
        simulator_warnings: MuJoCo's warnings meanwhile, in words; empty if there were none.
    """

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
) -> OptimizationResult:
    """Optimises q(ζ) with the settings that the task names.

    Args:
        task: the control problem.
        request: the solve to do.
        on_iteration: called with the log of each iteration.
        is_cancelled: asked between the parts of an iteration; true ends the solve.

    Raises:
        InvalidInputError: a value of the request does not fit the task.
        DivergenceError: the first rollout diverges, or the solve ends where q(ζ) would not be
            finite, as at an indefinite Quu; its status names the cause.
    """
    _check(task, request)
    warned_before = task.dynamics.warnings()
    start = first_motion(task, request, is_cancelled)
    scaled = ScaledCost(task.cost, request.cost_scale)
    cost: TrajectoryCost = scaled
    if request.policy and request.previous:
        place = (request.iteration, request.trajectory_index)
        rng = generator(request.seed, Stream.POLICY_DERIVATIVES, *place)
        deviations = sample_deviations(request.previous, task.optimizer.policy_samples, rng)
        policy, gains = request.policy, request.previous.gains
        cost = PolicyCost(scaled, policy, task.observation, deviations, gains)
    solution = solve(
        task.dynamics,
        cost,
        start.trajectory,
        _scaled(task.optimizer.ddp, request.cost_scale),
        request.max_iterations,
        linear_dynamics=start.linear_dynamics,
        gaps=start.gaps,
        on_iteration=on_iteration,
        is_cancelled=is_cancelled,
    )
    return OptimizationResult(
        distribution=_distribution(task, solution, request.cost_scale),
        cost=task.trajectory_cost(solution.trajectory.first(task.horizon)),
        modified_cost=solution.cost,
        status=solution.status,
        settings=task.optimizer,
        iterations=solution.iterations,
        simulator_steps=start.simulator_steps + solution.simulator_steps,
        simulator_warnings=in_words(task.dynamics.warnings() - warned_before),
    )


def optimize_all(
    task: Task, requests: Sequence[OptimizationRequest]
) -> tuple[OptimizationResult, ...]:
    """Solves several requests in this process, one after another."""
    return tuple(optimize(task, request) for request in requests)


def _check(task: Task, request: OptimizationRequest) -> None:
    n_x, n_u = task.dims["n_x"], task.dims["n_u"]
    positive("cost_scale", request.cost_scale)
    positive("max_iterations", request.max_iterations)
    check_array("initial_state", request.initial_state, (n_x,))
    if request.guess is not None:
        check_array("guess.controls", request.guess, (task.planned_horizon, n_u))
    if request.guess_states is not None:
        check_array("guess.states", request.guess_states, (task.planned_horizon + 1, n_x))
        if request.guess is None:
            raise InvalidInputError(
                "The request has guess.states without guess.controls: add them."
            )
    if request.previous is not None:
        check_distribution("previous", request.previous, task, request.initial_state)
    if request.policy is not None:
        request.policy.check_fits(task.observation.names, n_u)
        if request.previous is None:
            raise InvalidInputError(
                "The request has a policy but no previous distribution, from whose marginals "
                "the policy's derivatives are sampled; send both."
            )


@dataclass(frozen=True)
class FirstMotion:
    """The first trajectory, what is known of it (see `solve`), and the simulator steps it took."""

    trajectory: Trajectory
    simulator_steps: int = 0
    linear_dynamics: LinearDynamics | None = None
    gaps: Array | None = None


def first_request(task: Task, seed: int, iterations: int) -> OptimizationRequest:
    """Returns the first solve of a search that starts from the task's initial state."""
    drawn = generator(seed, Stream.INITIAL_CONTROLS, 0)
    return OptimizationRequest(
        trajectory_index=0,
        iteration=0,
        seed=seed,
        cost_scale=1.0,
        max_iterations=iterations,
        initial_state=task.initial_state,
        guess=task.guess(drawn) if task.guess else None,
        guess_states=task.path,
    )


def first_motion(
    task: Task, request: OptimizationRequest, is_cancelled: Callable[[], bool] = lambda: False
) -> FirstMotion:
    """Returns the motion from which a solve starts.

    Raises:
        InvalidInputError: neither request nor task names one.
        DivergenceError: the demonstration cannot be followed.
    """
    start, dynamics = request.initial_state, task.dynamics
    if request.previous is not None:
        previous = request.previous
        return FirstMotion(previous.mean, linear_dynamics=previous.linear_dynamics)
    if request.guess is not None and request.guess_states is not None:
        states = np.concatenate([start[None], request.guess_states[1:]])
        guessed = Trajectory(states, np.clip(request.guess, *dynamics.control_limits))
        steps = task.planned_horizon * dynamics.substeps
        return FirstMotion(guessed, steps, gaps=dynamics.gaps(guessed))
    if request.guess is not None:
        guess, horizon = request.guess, task.planned_horizon
        rollout = dynamics.rollout(start, lambda t, _: guess[t], horizon)
        return FirstMotion(rollout, horizon * dynamics.substeps)
    shown = task.demonstration
    recorded = shown is not None and np.array_equal(start, shown.states[0])
    if task.demonstrate is not None and not recorded:
        rng = generator(request.seed, Stream.INITIAL_CONTROLS, request.trajectory_index)
        motion = task.demonstrate(start, task.planned_horizon, rng, is_cancelled)
        return FirstMotion(motion)  # not counted as learning
    if shown is None:
        raise InvalidInputError("The request has neither guess nor previous; send one of them.")
    tolerance = task.optimizer.demonstration_tolerance
    followed, steps = track(dynamics, shown, start, task.position_names, tolerance)
    return FirstMotion(followed, steps)


def _distribution(task: Task, solution: Solution, alpha: float) -> TrajectoryDistribution:
    """Returns q(ζ) around the trajectory that was executed, with its marginals."""
    covariances = solution.policy.control_covariances()
    gains, linear = solution.policy.gains, solution.linear_dynamics
    settings = task.optimizer.marginals
    spread = settings.spread(task.initial_std, task.std_limit, task.velocities, alpha)
    return TrajectoryDistribution(
        mean=solution.trajectory,
        gains=gains,
        control_covariances=covariances,
        linear_dynamics=linear,
        state_covariances=state_covariances(linear, gains, covariances, spread),
    )


def check_distribution(name: str, q: TrajectoryDistribution, task: Task, start: Array) -> None:
    """Checks that q(ζ) has finite values, is one of the task, and begins at x_1.

    Raises:
        InvalidInputError: q(ζ) differs from that.
    """
    check_record(name, q, T=task.planned_horizon, **task.dims)
    if not np.array_equal(q.mean.states[0], start):
        raise InvalidInputError(
            f"initial_state is {start.tolist()}, but it must be where {name} starts, "
            f"{q.mean.states[0].tolist()}."
        )


def _scaled(settings: DdpSettings, alpha: float) -> DdpSettings:
    return replace(
        settings,
        initial_regularization=alpha * settings.initial_regularization,
        regularization_floor=alpha * settings.regularization_floor,
        distribution_regularization=alpha * settings.distribution_regularization,
    )
