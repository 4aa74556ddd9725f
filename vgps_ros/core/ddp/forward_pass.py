# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The forward pass: a line search along the local policy, on the true dynamics.

It works on iterates: trajectories with the expansions of dynamics and cost around them.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.ddp.backward_pass import LocalPolicy, backward_pass
from vgps_ros.core.dynamics import DynamicsModel
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.records import Array, ControlBounds, CostExpansion, LinearDynamics, Trajectory

_STEP_SIZES = tuple(0.5**i for i in range(8))  # tried in order, before μ grows
_ACCEPTANCE = 0.1  # least share of the expected cost reduction that a step must bring


@dataclass(frozen=True)
class Iterate:
    """A trajectory with the expansions around it.

    Attributes:
        trajectory: x̄, ū.
        linear: f_x, f_u.
        expansion: the cost's values and derivatives.
        bounds: the controls that act there.
        simulator_steps: simulator steps that the derivatives took.
        gaps: f(x̄, ū) ⊖ x̄' of each step, shape (T, n_dx); None if x̄, ū satisfies the dynamics.
    """

    trajectory: Trajectory
    linear: LinearDynamics
    expansion: CostExpansion
    bounds: ControlBounds
    simulator_steps: int
    gaps: Array | None = None

    @cached_property
    def cost(self) -> float:
        """Σ_t c(x̄_t, ū_t)."""
        return float(np.sum(self.expansion.c))


@dataclass(frozen=True)
class Problem:
    """Dynamics x' = f(x, u) and the cost to minimise."""

    dynamics: DynamicsModel
    cost: TrajectoryCost

    def __post_init__(self) -> None:
        """Checks the limits of the controls."""
        low, high = self.dynamics.control_limits
        for i in np.flatnonzero(~(low <= high)):
            raise InvalidInputError(
                f"Control {i} has limits from {low[i]:g} to {high[i]:g}, but the first must not be "
                "above the second: correct the range in the model."
            )

    def local_policy(self, around: Iterate, regularization: float) -> LocalPolicy:
        """Returns the local policy around an iterate, within the bounds of the controls."""
        controls, bounds = around.trajectory.controls, around.bounds
        return backward_pass(
            around.linear,
            around.expansion,
            regularization,
            (bounds.lowest - controls, bounds.highest - controls),
            around.gaps,
            bounds.slopes,
        )

    def around(
        self, trajectory: Trajectory, known: LinearDynamics | None = None, gaps: Array | None = None
    ) -> Iterate:
        """Expands dynamics and cost around a trajectory, whose f_x, f_u may be known already.

        Raises:
            DivergenceError: a value or a derivative is not finite.
        """
        linear, steps = (known, 0) if known else self.dynamics.linearize(trajectory)
        expansion = self.cost.expand(trajectory)
        for record, what in ((expansion, "cost"), (linear, "dynamics")):
            for name, values in vars(record).items():
                is_finite = np.isfinite(values)
                if not is_finite.all():
                    raise DivergenceError(
                        f"The {what} has a {name} that is not finite, at step "
                        f"{np.argwhere(~is_finite)[0][0]}: start "
                        "from smaller controls or another state, or lower alpha (cost_scale) or "
                        "the policy's parameters.",
                        "infinite_cost" if record is expansion else "diverged",
                    )
        bounds = self.dynamics.bounds_along(trajectory.states)
        return Iterate(trajectory, linear, expansion, bounds, steps, gaps)


@dataclass(frozen=True)
class ForwardStep:
    """One step that the line search tried.

    Attributes:
        trajectory: the new trajectory, NaN from where it diverges.
        gaps: what is left of the gaps, shape (T, n_dx); None if there are none.
        cost: its cost; NaN if it diverges.
        step_size: α.
        expected_reduction: the reduction of the cost that the quadratic model expects of α.
        is_accepted: whether the merit falls by enough of that; never where the cost is NaN.
    """

    trajectory: Trajectory
    gaps: Array | None
    cost: float
    step_size: float
    expected_reduction: float
    is_accepted: bool


def forward_pass(problem: Problem, around: Iterate, policy: LocalPolicy) -> list[ForwardStep]:
    """Tries u = ū + α k + K (x ⊖ x̄) with falling α; returns all steps up to the accepted one.

    A step closes its share α of each gap, and all of them at α = 1 (Mastalli et al., ICRA 2020).
    """
    nominal, gaps = around.trajectory, around.gaps
    nominals = [
        Trajectory(nominal.states, nominal.controls + step_size * policy.feedforward)
        for step_size in _STEP_SIZES
    ]
    left = [None if gaps is None or a == 1.0 else (1.0 - a) * gaps for a in _STEP_SIZES]
    model, worth = (policy, 0.0) if gaps is None else _while_closing(gaps, around, policy)
    tried: list[ForwardStep] = []
    found = problem.dynamics.follow_each(nominal.states[0], nominals, policy.gains, left)
    for step_size, trajectory, gap in zip(_STEP_SIZES, found, left, strict=True):
        cost = float(np.sum(problem.cost.values(trajectory)))
        expected = model.expected_reduction(step_size)
        brought, promised = (r + step_size * worth for r in (around.cost - cost, expected))
        enough = brought > max(_ACCEPTANCE * promised, 0.0)
        tried.append(ForwardStep(trajectory, gap, cost, step_size, expected, enough))
        if not enough:
            continue
        if gap is not None:  # what is left of it may be so small that feedback makes up for it
            (closed,) = problem.dynamics.follow_each(nominal.states[0], [trajectory], policy.gains)
            cost = float(np.sum(problem.cost.values(closed)))
            promised, brought = expected + worth, around.cost - cost + worth
            enough = brought > max(_ACCEPTANCE * promised, 0.0)
            step = ForwardStep(closed, None, cost, step_size, expected, enough)
            tried.insert(len(tried) - (not enough), step)
        break
    return tried


def _while_closing(gaps: Array, around: Iterate, policy: LocalPolicy) -> tuple[LocalPolicy, float]:
    """Returns the policy with slope and curvature as they are while it closes gaps; and ν Σ‖d‖₁.

    The cost may have to rise for that. So the line search judges cost + ν Σ‖d‖₁, an exact penalty,
    of which a step brings α ν Σ‖d‖₁ by the gaps alone. ν is the smallest one for which the model
    expects a whole step to bring at least half of that.
    """
    linear, e = around.linear, around.expansion
    slope = curvature = 0.0
    x = np.zeros(gaps.shape[1])
    for t, gap in enumerate(gaps):
        u = policy.feedforward[t] + policy.gains[t] @ x
        slope += e.c_x[t] @ x + e.c_u[t] @ u
        curvature += x @ e.c_xx[t] @ x + 2 * u @ e.c_ux[t] @ x + u @ e.c_uu[t] @ u
        x = linear.f_x[t] @ x + linear.f_u[t] @ u + gap
    model = replace(policy, slope=float(slope), curvature=float(curvature))
    return model, max(0.0, 2.0 * (model.slope + 0.5 * max(model.curvature, 0.0)))
