"""Trajectory optimisation by iterative LQR.

    minimise  Σ_{t=1..T} c(x_t, u_t)   subject to  x_{t+1} = f(x_t, u_t),  x_1 given.

Each iteration expands dynamics and cost around the current trajectory, computes the local policy
(backward pass) and searches along it (forward pass). The solve prints nothing: it returns a named
status and a frozen log, and calls `on_iteration` while it runs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.ddp.backward_pass import LocalPolicy, backward_pass
from vgps_ros.core.ddp.forward_pass import ForwardStep, forward_pass
from vgps_ros.core.dynamics import Dynamics
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import CostExpansion, LinearDynamics, Trajectory


class Status(str, Enum):
    """Why a solve ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration_limit"
    NO_DESCENT = "no_descent"
    INDEFINITE_QUU = "indefinite_quu"
    CANCELLED = "cancelled"


@dataclass(frozen=True)
class Iteration:
    """Log of one iteration; `step_size` is 0 where no step was accepted."""

    index: int
    cost: float
    cost_reduction: float
    expected_reduction: float
    step_size: float
    regularization: float


@dataclass(frozen=True)
class Solution:
    """Result of a solve.

    Attributes:
        trajectory: the last accepted trajectory.
        cost: its cost.
        policy: the local policy around it, from a backward pass of its own.
        linear_dynamics: f_x, f_u around it.
        status: why the solve ended.
        iterations: log, one entry an iteration.
    """

    trajectory: Trajectory
    cost: float
    policy: LocalPolicy
    linear_dynamics: LinearDynamics
    status: Status
    iterations: tuple[Iteration, ...]


class _Regularization:
    """μ and the factor by which it changes, after Tassa, Erez and Todorov (IROS 2012)."""

    def __init__(self, settings: DdpSettings):
        self._settings = settings
        self.mu = max(settings.initial_regularization, settings.regularization_floor)
        self._factor = 1.0

    def grow(self) -> bool:
        """Raises μ; false if it passes the limit."""
        self._factor = max(self._factor, 1.0) * self._settings.regularization_factor
        self.mu = max(self.mu * self._factor, 1e-6)
        return self.mu <= self._settings.regularization_limit

    def shrink(self) -> None:
        """Lowers μ, down to its floor."""
        self._factor = min(self._factor, 1.0) / self._settings.regularization_factor
        self.mu = max(self.mu * self._factor, self._settings.regularization_floor)


def solve(
    dynamics: Dynamics,
    cost: TrajectoryCost,
    initial: Trajectory,
    settings: DdpSettings,
    max_iterations: int,
    *,
    linear_dynamics: LinearDynamics | None = None,
    on_iteration: Callable[[Iteration], None] = lambda _: None,
    is_cancelled: Callable[[], bool] = lambda: False,
) -> Solution:
    """Optimises a trajectory.

    Args:
        dynamics: x' = f(x, u).
        cost: what to minimise.
        initial: where to start from; it must satisfy the dynamics.
        settings: regularisation, line search and tolerance.
        max_iterations: iterations at most, at least 1.
        linear_dynamics: f_x, f_u around `initial`, where the caller has them already.
        on_iteration: called with each iteration's log.
        is_cancelled: asked between the parts of an iteration; true ends the solve.

    Raises:
        DivergenceError: the initial trajectory, its cost or a derivative is not finite, or Quu is
            indefinite where q is centred.
    """
    if not (np.isfinite(initial.states).all() and np.isfinite(initial.controls).all()):
        raise DivergenceError(
            "The initial trajectory diverges; start from smaller controls or another state."
        )
    trajectory = initial
    linear = linear_dynamics or dynamics.linearize(trajectory)
    expansion = cost.expand(trajectory)
    _check_finite(linear, expansion)
    value = float(np.sum(expansion.c))
    regularization = _Regularization(settings)
    log: list[Iteration] = []
    status = Status.ITERATION_LIMIT
    while len(log) < max_iterations:
        step = _search(
            dynamics, cost, trajectory, value, linear, expansion, regularization, settings,
            is_cancelled,
        )  # fmt: skip
        if isinstance(step, Status):
            status = step
            break
        log.append(
            Iteration(
                index=len(log) + 1,
                cost=step.cost,
                cost_reduction=value - step.cost,
                expected_reduction=step.expected_reduction,
                step_size=step.step_size,
                regularization=regularization.mu,
            )
        )
        on_iteration(log[-1])
        regularization.shrink()
        trajectory, value = step.trajectory, step.cost
        linear = dynamics.linearize(trajectory)
        expansion = cost.expand(trajectory)
        _check_finite(linear, expansion)
        if log[-1].cost_reduction < settings.cost_tolerance * abs(value):
            status = Status.CONVERGED
            break
    policy = _distribution_policy(linear, expansion, settings)
    return Solution(trajectory, value, policy, linear, status, tuple(log))


def _search(
    dynamics: Dynamics,
    cost: TrajectoryCost,
    trajectory: Trajectory,
    value: float,
    linear: LinearDynamics,
    expansion: CostExpansion,
    regularization: _Regularization,
    settings: DdpSettings,
    is_cancelled: Callable[[], bool],
) -> ForwardStep | Status:
    """Raises μ until a step lowers the cost; says why if none does."""
    first_mu = regularization.mu
    while not is_cancelled():
        policy = backward_pass(linear, expansion, regularization.mu)
        if policy.complete:
            negligible = settings.cost_tolerance * abs(value)
            if regularization.mu == first_mu and policy.expected_reduction(1.0) <= negligible:
                return Status.CONVERGED
            step = forward_pass(dynamics, cost, trajectory, value, policy, settings)
            if step is not None:
                return step
        if not regularization.grow():
            return Status.NO_DESCENT if policy.complete else Status.INDEFINITE_QUU
    return Status.CANCELLED


def _check_finite(linear: LinearDynamics, expansion: CostExpansion) -> None:
    for record, what in ((expansion, "cost"), (linear, "dynamics")):
        for name, values in vars(record).items():
            bad = np.argwhere(~np.isfinite(values))
            if bad.size:
                raise DivergenceError(
                    f"The {what} has a {name} that is not finite, at step {bad[0][0]}: start from "
                    "smaller controls or another state, or lower alpha (cost_scale) or the "
                    "policy's parameters.",
                    "infinite_cost" if record is expansion else "diverged",
                )


def _distribution_policy(
    linear: LinearDynamics, expansion: CostExpansion, settings: DdpSettings
) -> LocalPolicy:
    """The backward pass whose gains and covariances make q(ζ)."""
    policy = backward_pass(linear, expansion, settings.distribution_regularization)
    if not policy.complete:
        raise DivergenceError(
            "Quu is not positive definite at distribution_regularization="
            f"{settings.distribution_regularization}; raise it.",
            "indefinite_quu",
        )
    return policy
