# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trajectory optimisation by iterative LQR.

    minimise  Σ_{t=1..T} c(x_t, u_t)   subject to  x_{t+1} = f(x_t, u_t),  low ≤ u_t ≤ high,
                                                   x_1 given.

Each iteration expands dynamics and cost around the current trajectory, computes the local policy
(backward pass) and searches along it (forward pass). A start that does not satisfy the dynamics, as
a path that somebody drew, has gaps; the iterations close them, and from then on all is as if there
had been none. The solve prints nothing: it returns a named status and a frozen log, and calls
`on_iteration` while it runs.

`improve` makes one iteration whose result may drive a robot at once. Derivatives take most of an
iteration's time. A solve needs them around each trajectory that it finds, its last one too, since q
has its covariances there. A plan that another one replaces within moments is instead followed with
gains from around the motion that was improved, and so costs half as much: the real-time iteration
of Diehl, Bock and Schlöder (SIAM J. Control Optim. 2005).
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.ddp.backward_pass import LocalPolicy
from vgps_ros.core.ddp.forward_pass import ForwardStep, Iterate, Problem, forward_pass
from vgps_ros.core.dynamics import DynamicsModel
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import Array, LinearDynamics, Trajectory

COST_TOLERANCE = 1e-7  # relative cost reduction below which a solve has converged
_GROWTH = 1.6  # of the factor by which μ changes
_LARGEST_MU = 1e10  # beyond which a solve gives up
_CLOSED = 1e-9  # gaps that are no more than rounding


class Status(str, Enum):
    """The reasons for which a solve ends."""

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
        status: the reason why the solve ended.
        iterations: the log, with one entry for each iteration.
        simulator_steps: simulator steps of all its rollouts and derivatives.
    """

    trajectory: Trajectory
    cost: float
    policy: LocalPolicy
    linear_dynamics: LinearDynamics
    status: Status
    iterations: tuple[Iteration, ...]
    simulator_steps: int


class _StepSearch:
    """Finds a better trajectory for each iteration.

    The regularisation μ changes by a factor that itself changes, after Tassa, Erez and Todorov
    (IROS 2012).

    Attributes:
        mu: μ of the latest backward pass.
        simulator_steps: simulator steps of the rollouts so far.
    """

    def __init__(self, problem: Problem, settings: DdpSettings, is_cancelled: Callable[[], bool]):
        self._problem = problem
        self._settings = settings
        self._is_cancelled = is_cancelled
        self._factor = 1.0
        self.mu = max(settings.initial_regularization, settings.regularization_floor)
        self.simulator_steps = 0

    def next_step(self, around: Iterate, negligible: float) -> ForwardStep | Status:
        """Raises μ until a step lowers the cost; returns the status that ends the solve if none.

        A solve has converged where no more than what is negligible can be expected.
        """
        first_mu, horizon = self.mu, around.trajectory.horizon
        while not self._is_cancelled():
            policy = self._problem.local_policy(around, self.mu)
            if policy.complete:
                is_small = policy.expected_reduction(1.0) <= negligible
                if not _are_open(around.gaps) and self.mu == first_mu and is_small:
                    return Status.CONVERGED
                tried = forward_pass(self._problem, around, policy)
                self.simulator_steps += len(tried) * horizon * self._problem.dynamics.substeps
                if tried[-1].is_accepted:
                    return tried[-1]
            if not self._raise_mu():
                return Status.NO_DESCENT if policy.complete else Status.INDEFINITE_QUU
        return Status.CANCELLED

    def _raise_mu(self) -> bool:
        """Returns false if μ passes its limit."""
        self._factor = max(self._factor, 1.0) * _GROWTH
        self.mu = max(self.mu * self._factor, 1e-6)
        return self.mu <= _LARGEST_MU

    def lower_mu(self) -> None:
        """Lowers μ, down to its floor."""
        self._factor = min(self._factor, 1.0) / _GROWTH
        self.mu = max(self.mu * self._factor, self._settings.regularization_floor)


def solve(
    dynamics: DynamicsModel,
    cost: TrajectoryCost,
    initial: Trajectory,
    settings: DdpSettings,
    max_iterations: int,
    *,
    linear_dynamics: LinearDynamics | None = None,
    gaps: Array | None = None,
    cost_tolerance: float = COST_TOLERANCE,
    tolerance: float = 0.0,
    on_iteration: Callable[[Iteration], None] = lambda _: None,
    is_cancelled: Callable[[], bool] = lambda: False,
) -> Solution:
    """Optimises a trajectory.

    Args:
        dynamics: x' = f(x, u).
        cost: c(x, u).
        initial: trajectory to start from.
        settings: its regularisation.
        max_iterations: largest number of iterations, at least 1.
        linear_dynamics: f_x, f_u around `initial`, where the caller has them already.
        gaps: f(x̄, ū) ⊖ x̄' of each step of `initial`, shape (T, n_dx), where it does not satisfy
            the dynamics; they are closed on the way. None: it was executed.
        cost_tolerance: share of the cost; an iteration that brings less ends the solve.
        tolerance: the same of what the iterations have brought so far; the larger one counts.
        on_iteration: called with each iteration's log.
        is_cancelled: called between the parts of an iteration; true ends the solve.

    Raises:
        DivergenceError: the initial trajectory, its cost or a derivative is not finite, gaps stay
            open, or Quu is indefinite where q is centred.
        InvalidInputError: the limits of the controls contradict each other.
    """
    given = (initial.states, initial.controls, *([] if gaps is None else [gaps]))
    if not all(np.isfinite(array).all() for array in given):
        raise DivergenceError(
            "The initial trajectory diverges; start from smaller controls or another state."
        )
    problem = Problem(dynamics, cost)
    search = _StepSearch(problem, settings, is_cancelled)
    iterate = problem.around(initial, linear_dynamics, gaps)
    derivative_steps = iterate.simulator_steps
    log, brought, status = list[Iteration](), 0.0, Status.ITERATION_LIMIT
    negligible = cost_tolerance * abs(iterate.cost)
    while len(log) < max_iterations:
        step = search.next_step(iterate, negligible)
        if isinstance(step, Status):
            status = step
            break
        reduction, had_gaps = iterate.cost - step.cost, iterate.gaps is not None
        of_step = step.expected_reduction, step.step_size, search.mu
        log.append(Iteration(len(log) + 1, step.cost, reduction, *of_step))
        on_iteration(log[-1])
        search.lower_mu()
        iterate = problem.around(step.trajectory, gaps=step.gaps)
        derivative_steps += iterate.simulator_steps
        brought += reduction
        negligible = max(tolerance * brought, cost_tolerance * abs(iterate.cost))
        if reduction < negligible and not had_gaps:
            status = Status.CONVERGED
            break
    if status is not Status.CANCELLED:
        _refuse_gaps(iterate.gaps, len(log), status)
    return Solution(
        trajectory=iterate.trajectory,
        cost=iterate.cost,
        policy=centre_of_q(problem, iterate, settings.distribution_regularization),
        linear_dynamics=iterate.linear,
        status=status,
        iterations=tuple(log),
        simulator_steps=derivative_steps + search.simulator_steps,
    )


def _refuse_gaps(gaps: Array | None, iterations: int, status: Status) -> None:
    """Raises DivergenceError if gaps are left at the end of a solve."""
    if gaps is not None and _are_open(gaps):
        raise DivergenceError(
            f"No robot can follow the motion: after {iterations} iterations "
            f"({status.value.replace('_', ' ')}) its gaps are still up to {np.abs(gaps).max():.2g} "
            "[m, rad, m/s, rad/s]; allow more iterations, or begin with another motion.",
            "open_gaps",
        )


def _are_open(gaps: Array | None) -> bool:
    return gaps is not None and not np.abs(gaps).max(initial=0.0) <= _CLOSED


def centre_of_q(problem: Problem, found: Iterate, mu: float) -> LocalPolicy:
    """Returns the local policy around a solve's result, whose covariances make q(ζ).

    Raises:
        DivergenceError: Quu is indefinite there.
    """
    policy = problem.local_policy(found, mu)
    if not policy.complete:
        raise DivergenceError(
            f"Quu is not positive definite at distribution_regularization={mu}; raise it.",
            "indefinite_quu",
        )
    return policy


@dataclass(frozen=True)
class Improvement:
    """Result of one iteration."""

    trajectory: Trajectory  # the improved motion, or the given one where no step was accepted
    gains: Array  # K from around the given motion, shape (T, n_u, n_dx)
    cost: float  # the trajectory's cost
    status: Status  # `iteration_limit` where a step was accepted; else the reason why none was


def improve(
    dynamics: DynamicsModel,
    cost: TrajectoryCost,
    motion: Trajectory,
    settings: DdpSettings,
    is_cancelled: Callable[[], bool] = lambda: False,
) -> Improvement:
    """Improves a motion by one iteration, with one expansion of the dynamics and the cost.

    The motion satisfies the dynamics. Whether to end is asked between the parts of the iteration.

    Raises:
        DivergenceError: the motion's cost or a derivative is not finite, or Quu is indefinite
            around it.
    """
    problem = Problem(dynamics, cost)
    around = problem.around(motion)
    negligible = COST_TOLERANCE * abs(around.cost)
    step = _StepSearch(problem, settings, is_cancelled).next_step(around, negligible)
    gains = centre_of_q(problem, around, settings.distribution_regularization).gains
    if isinstance(step, Status):
        return Improvement(motion, gains, around.cost, step)
    return Improvement(step.trajectory, gains, step.cost, Status.ITERATION_LIMIT)
