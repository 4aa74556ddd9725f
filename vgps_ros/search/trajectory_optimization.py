"""Lines 1, 3 and 6 of Algorithm 1: optimise q(ζ) by DDP and compute its marginals.

An optimisation is a pure function of its request, so it gives the same numbers in this process, in
another one, or on another machine of the same kind.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vgps_ros.core.checks import check_array, check_record, positive
from vgps_ros.core.ddp import DdpSettings, Iteration, Solution, Status, solve
from vgps_ros.core.ddp.tracking import track
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.marginals import sample_deviations, state_covariances
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.records import Array, LinearDynamics, Trajectory, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.simulation.warnings import in_words, simulator_warnings
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class OptimizationRequest:
    """One solve.

    Attributes:
        trajectory_index: which initial state of Algorithm 1.
        iteration: k of Algorithm 1; 0 for the initial solve.
        seed: seed of the run.
        cost_scale: α.
        max_iterations: DDP iterations at most.
        initial_state: x_1, shape (n_x,).
        guess: controls (T, n_u) to start from, where there is no `previous`.
        previous: q(ζ) of the iteration before.
        policy: π_θ; without it the cost is α c alone.
    """

    trajectory_index: int
    iteration: int
    seed: int
    cost_scale: float
    max_iterations: int
    initial_state: Array
    guess: Array | None = None
    previous: TrajectoryDistribution | None = None
    policy: GaussianPolicy | None = None


@dataclass(frozen=True)
class OptimizationResult:
    """What a solve returns.

    Attributes:
        distribution: q(ζ).
        cost: Σ c of its mean over the scored horizon, unscaled and without the policy term.
        modified_cost: what was minimised.
        status: why the solve ended.
        iterations: its log.
        simulator_steps: that it took, finite differences included.
        simulator_warnings: what MuJoCo warned of meanwhile, in words; empty if of nothing.
    """

    distribution: TrajectoryDistribution
    cost: float
    modified_cost: float
    status: Status
    iterations: tuple[Iteration, ...]
    simulator_steps: int
    simulator_warnings: str = ""


class TrajectoryOptimizer:
    """Optimises q(ζ) of one task, with the settings that it names."""

    def __init__(self, task: Task):
        self.task = task

    def optimize(
        self,
        request: OptimizationRequest,
        on_iteration: Callable[[Iteration], None] = lambda _: None,
        is_cancelled: Callable[[], bool] = lambda: False,
    ) -> OptimizationResult:
        """Solves one request.

        Raises:
            InvalidInputError: a value of the request does not fit the task.
            DivergenceError: the first rollout diverges, or there is no q(ζ) of finite numbers
                around what was found; its status names the cause.
        """
        self._check(request)
        steps_before = self.task.dynamics.simulator_steps
        warned_before = simulator_warnings()
        initial, linear = self._start(request)
        cost = ScaledCost(self.task.cost, request.cost_scale)
        solution = solve(
            self.task.dynamics,
            cost if request.policy is None else self._policy_cost(cost, request),
            initial,
            _scaled(self.task.optimizer.ddp, request.cost_scale),
            request.max_iterations,
            linear_dynamics=linear,
            on_iteration=on_iteration,
            is_cancelled=is_cancelled,
        )
        return OptimizationResult(
            distribution=self._distribution(solution, request.cost_scale),
            cost=self.task.trajectory_cost(solution.trajectory.first(self.task.horizon)),
            modified_cost=solution.cost,
            status=solution.status,
            iterations=solution.iterations,
            simulator_steps=self.task.dynamics.simulator_steps - steps_before,
            simulator_warnings=in_words(simulator_warnings() - warned_before),
        )

    def _check(self, request: OptimizationRequest) -> None:
        dynamics = self.task.dynamics
        n_x, n_u = dynamics.state_dim, dynamics.control_dim
        positive("cost_scale", request.cost_scale)
        positive("max_iterations", request.max_iterations)
        check_array("initial_state", request.initial_state, (n_x,))
        if request.guess is not None:
            check_array("guess.controls", request.guess, (self.task.planned_horizon, n_u))
        if request.previous is not None:
            check_distribution("previous", request.previous, self.task, request.initial_state)
        if request.policy is not None:
            request.policy.check_fits(n_x, n_u)
            if request.previous is None:
                raise InvalidInputError(
                    "The request has a policy but no previous distribution, from whose marginals "
                    "the policy's derivatives are sampled; send both."
                )

    def _start(self, request: OptimizationRequest) -> tuple[Trajectory, LinearDynamics | None]:
        """The trajectory to start from, and its derivatives where they are known."""
        if request.previous is not None:
            return request.previous.mean, request.previous.linear_dynamics
        if request.guess is None:
            if self.task.demonstration is None:
                raise InvalidInputError(
                    "The request has neither guess nor previous; send one of them."
                )
            return self._follow_demonstration(self.task.demonstration, request.initial_state), None
        controls = request.guess
        initial = self.task.dynamics.rollout(
            request.initial_state, lambda t, _: controls[t], self.task.planned_horizon
        )
        return initial, None

    def _follow_demonstration(self, demonstration: Trajectory, start: Array) -> Trajectory:
        """The demonstration as this model executes it from x_1."""
        moved = not np.array_equal(start, demonstration.states[0])
        if moved and self.task.demonstrate is not None:
            return self.task.demonstrate(start, self.task.planned_horizon)
        return track(
            self.task.dynamics,
            demonstration,
            start,
            self.task.joint_names,
            self.task.optimizer.demonstration_tolerance,
        )

    def _policy_cost(self, scaled: ScaledCost, request: OptimizationRequest) -> PolicyCost:
        assert request.previous is not None
        assert request.policy is not None
        place = (request.iteration, request.trajectory_index)
        rng = generator(request.seed, Stream.POLICY_DERIVATIVES, *place)
        deviations = sample_deviations(request.previous, self.task.optimizer.policy_samples, rng)
        return PolicyCost(scaled, request.policy, deviations, request.previous.gains)

    def _distribution(self, solution: Solution, alpha: float) -> TrajectoryDistribution:
        """q(ζ) around the trajectory that was executed, with its marginals."""
        covariances = solution.policy.control_covariances()
        gains, linear = solution.policy.gains, solution.linear_dynamics
        settings, task = self.task.optimizer.marginals, self.task
        spread = settings.spread(task.initial_std, task.std_limit, alpha)
        marginals = state_covariances(linear, gains, covariances, spread)
        return TrajectoryDistribution(
            mean=solution.trajectory,
            gains=gains,
            control_covariances=covariances,
            linear_dynamics=linear,
            state_covariances=marginals,
        )


def check_distribution(name: str, q: TrajectoryDistribution, task: Task, start: Array) -> None:
    """Checks that q(ζ) has finite values, is one of the task, and begins at x_1.

    Raises:
        InvalidInputError: it is not.
    """
    n_x, n_u = task.dynamics.state_dim, task.dynamics.control_dim
    check_record(name, q, T=task.planned_horizon, n_x=n_x, n_u=n_u)
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
