# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The request for one solve of a policy search, its check, and the motion from which it starts."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vgps_ros.core.checks import check_array, check_record, positive
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, Trajectory, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.situations import Situation
from vgps_ros.tasks import Task
from vgps_ros.tasks.task import Nominal


@dataclass(frozen=True)
class OptimizationRequest:
    """The input of one solve.

    Attributes:
        trajectory_index: index of the situation in Algorithm 1.
        iteration: k of Algorithm 1; 0 for the initial solve.
        seed: seed of the run.
        cost_scale: α.
        max_iterations: largest number of DDP iterations.
        situation: x_1, the commands, and what disturbs the robot.
        guess: controls (T, n_u) to start from if there is no `previous`; None: the task's own first
            motion.
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
    situation: Situation
    guess: Array | None = None
    guess_states: Array | None = None
    previous: TrajectoryDistribution | None = None
    policy: GaussianPolicy | None = None

    @property
    def initial_state(self) -> Array:
        """x_1, shape (n_x,)."""
        return self.situation.initial_state


def first_request(task: Task, seed: int, iterations: int) -> OptimizationRequest:
    """Returns the first solve of a search that starts from the task's initial state."""
    return OptimizationRequest(
        trajectory_index=0,
        iteration=0,
        seed=seed,
        cost_scale=1.0,
        max_iterations=iterations,
        situation=Situation.at_start(task),
    )


def initial_motion(
    task: Task, request: OptimizationRequest, is_cancelled: Callable[[], bool] = lambda: False
) -> Nominal:
    """Returns the motion from which a solve starts: the last solve's, a given one, or the task's.

    Raises:
        DivergenceError: a recorded motion cannot be followed.
    """
    start, dynamics, horizon = request.initial_state, task.dynamics, task.planned_horizon
    if request.previous is not None:
        previous = request.previous
        # A solve descends along the trajectory itself, of which means over q know little.
        is_mean = task.optimizer.dynamics_samples > 0
        return Nominal(previous.mean, linear_dynamics=None if is_mean else previous.linear_dynamics)
    if request.guess is None:
        rng = generator(request.seed, Stream.INITIAL_CONTROLS, request.trajectory_index)
        return task.begin(task, start, horizon, rng, is_cancelled)
    guess = request.guess
    if request.guess_states is not None:
        states = np.concatenate([start[None], request.guess_states[1:]])
        guessed = Trajectory(states, np.clip(guess, *dynamics.control_limits))
        return Nominal.guessed(guessed, dynamics)
    rollout = dynamics.rollout(start, lambda t, _: guess[t], horizon)
    return Nominal(rollout, horizon * dynamics.substeps)


def check_request(task: Task, request: OptimizationRequest) -> None:
    """Checks that a request fits the task.

    Raises:
        InvalidInputError: a value does not fit.
    """
    n_x, n_u = task.dims["n_x"], task.dims["n_u"]
    positive("cost_scale", request.cost_scale)
    positive("max_iterations", request.max_iterations)
    check_array("initial_state", request.initial_state, (n_x,))
    check_array("context", request.situation.context, (task.planned_horizon, task.dims["n_z"]))
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
