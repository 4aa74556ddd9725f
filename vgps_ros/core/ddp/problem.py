"""The problem that a solve works on, and the linear-quadratic model around one of its iterates."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.dynamics import Dynamics
from vgps_ros.core.errors import DivergenceError
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
