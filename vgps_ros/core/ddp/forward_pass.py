"""The forward pass: a line search along the local policy, on the true dynamics.

It works on iterates: trajectories with the expansions of dynamics and cost around them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.ddp.backward_pass import LocalPolicy, backward_pass
from vgps_ros.core.dynamics import Dynamics
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import CostExpansion, LinearDynamics, Trajectory


@dataclass(frozen=True)
class Iterate:
    """A trajectory with the expansions around it.

    Attributes:
        trajectory: x̄, ū.
        linear: f_x, f_u.
        expansion: the cost's values and derivatives.
        simulator_steps: simulator steps that the derivatives took.
    """

    trajectory: Trajectory
    linear: LinearDynamics
    expansion: CostExpansion
    simulator_steps: int

    @cached_property
    def cost(self) -> float:
        """Σ_t c(x̄_t, ū_t)."""
        return float(np.sum(self.expansion.c))


@dataclass(frozen=True)
class Problem:
    """Dynamics x' = f(x, u) and the cost to minimise."""

    dynamics: Dynamics
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
        """Returns the local policy around an iterate, within the limits of the controls."""
        low, high = self.dynamics.control_limits
        controls = around.trajectory.controls
        bounds = (low - controls, high - controls)
        return backward_pass(around.linear, around.expansion, regularization, bounds)

    def around(self, trajectory: Trajectory, known: LinearDynamics | None = None) -> Iterate:
        """Expands dynamics and cost around a trajectory, whose f_x, f_u may be known already.

        Raises:
            DivergenceError: a value or a derivative is not finite.
        """
        linear, steps = (known, 0) if known else self.dynamics.linearize(trajectory)
        expansion = self.cost.expand(trajectory)
        for record, what in ((expansion, "cost"), (linear, "dynamics")):
            for name, values in vars(record).items():
                bad = np.argwhere(~np.isfinite(values))
                if bad.size:
                    raise DivergenceError(
                        f"The {what} has a {name} that is not finite, at step {bad[0][0]}: start "
                        "from smaller controls or another state, or lower alpha (cost_scale) or "
                        "the policy's parameters.",
                        "infinite_cost" if record is expansion else "diverged",
                    )
        return Iterate(trajectory, linear, expansion, steps)


@dataclass(frozen=True)
class ForwardStep:
    """One step that the line search tried.

    Attributes:
        trajectory: the new trajectory, NaN from where it diverges.
        cost: its cost; NaN if it diverges.
        step_size: α.
        expected_reduction: the reduction of the cost that the quadratic model expects of α.
        is_accepted: whether the cost falls by enough of that; never where it is NaN.
    """

    trajectory: Trajectory
    cost: float
    step_size: float
    expected_reduction: float
    is_accepted: bool


def forward_pass(
    problem: Problem, around: Iterate, policy: LocalPolicy, settings: DdpSettings
) -> list[ForwardStep]:
    """Tries u = ū + α k + K (x ⊖ x̄) with falling α; returns all steps up to the accepted one."""
    nominal = around.trajectory
    step_sizes = settings.line_search_shrink ** np.arange(settings.line_search_steps)
    nominals = [
        Trajectory(nominal.states, nominal.controls + step_size * policy.feedforward)
        for step_size in step_sizes
    ]
    tried: list[ForwardStep] = []
    found = problem.dynamics.follow_each(nominal.states[0], nominals, policy.gains)
    for step_size, trajectory in zip(step_sizes.tolist(), found, strict=True):
        cost = float(np.sum(problem.cost.values(trajectory)))
        expected = policy.expected_reduction(step_size)
        enough = around.cost - cost > max(settings.acceptance_ratio * expected, 0.0)
        tried.append(ForwardStep(trajectory, cost, step_size, expected, enough))
        if enough:
            break
    return tried
