"""The form of cost that the paper's tasks share, and the protocol that DDP needs of any cost.

    c(x, u) = w_u ‖u‖² + Σ_i (r_i(x) − r_i*)²

The Hessian in x is Gauss-Newton's, 2 JᵀJ, which is never indefinite.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vgps_ros.core.records import Array, CostExpansion, Trajectory

Features = Callable[[Array], tuple[Array, Array]]
"""Maps states (..., n_x) to features r (..., m) and their Jacobian (..., m, n_x)."""


class TrajectoryCost(Protocol):
    """A cost that is a sum over the steps of a trajectory."""

    def values(self, trajectory: Trajectory) -> Array:
        """Returns the cost of each step, shape (T,)."""

    def expand(self, trajectory: Trajectory) -> CostExpansion:
        """Returns values and derivatives of each step."""


@dataclass(frozen=True)
class FeatureCost:
    """w_u ‖u‖² + ‖r(x) − r*‖², dimensionless.

    Attributes:
        features: r and its Jacobian.
        targets: r*, shape (m,), in the units of r.
        control_weight: w_u [1/(N²·m²)].
    """

    features: Features
    targets: Array
    control_weight: float

    def __call__(self, states: Array, controls: Array) -> Array:
        """Returns c(x, u), shape (...,), for states (..., n_x) and controls (..., n_u)."""
        residuals = self.features(states)[0] - self.targets
        return self.control_weight * np.sum(controls**2, -1) + np.sum(residuals**2, -1)

    @property
    def rest(self) -> float:
        """Cost of a step in which features and controls are zero, ‖r*‖²."""
        return float(np.sum(self.targets**2))

    def values(self, trajectory: Trajectory) -> Array:
        """Returns the cost of each step, shape (T,)."""
        return self(trajectory.states[:-1], trajectory.controls)

    def expand(self, trajectory: Trajectory) -> CostExpansion:
        """Returns values and Gauss-Newton derivatives of each step."""
        states, controls = trajectory.states[:-1], trajectory.controls
        (horizon, n_x), n_u = states.shape, controls.shape[1]
        features, jacobians = self.features(states)
        residuals = features - self.targets
        return CostExpansion(
            c=self.values(trajectory),
            c_x=2 * np.einsum("tmx,tm->tx", jacobians, residuals),
            c_u=2 * self.control_weight * controls,
            c_xx=2 * np.einsum("tmx,tmy->txy", jacobians, jacobians),
            c_uu=np.tile(2 * self.control_weight * np.eye(n_u), (horizon, 1, 1)),
            c_ux=np.zeros((horizon, n_u, n_x)),
        )
