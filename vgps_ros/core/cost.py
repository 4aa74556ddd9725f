# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The form of cost that all tasks share, and the protocol that DDP needs of any cost.

    c_t(x, u) = Σ_i w_ti ρ_i(r_i(x, u) − r*_ti) + Σ_j w_j u_j²

where r are readings of the state, such as a velocity or a height, and ρ is a norm: e², or the
smooth absolute value √(e² + s²) − s, which grows only linearly for |e| above s. Gauss-Newton's
Hessian, Σ w ρ'' Jᵀ J with J = ∂r/∂δ, is never indefinite.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from vgps_ros.core.records import Array, CostExpansion, Trajectory


class Features(Protocol):
    """r(x, u) with its derivatives; `vgps_ros.simulation.readings` has one for MuJoCo models."""

    def __call__(self, states: Array, controls: Array) -> Array:
        """Returns r, shape (..., m), for states (..., n_x) and controls (..., n_u)."""

    def linearize(self, states: Array, controls: Array) -> tuple[Array, Array, Array]:
        """Returns r (..., m), and its derivatives (..., m, n_dx) and (..., m, n_u)."""


class TrajectoryCost(Protocol):
    """A cost that is a sum over the steps of a trajectory."""

    def values(self, trajectory: Trajectory) -> Array:
        """Returns the cost of each step, shape (T,)."""

    def expand(self, trajectory: Trajectory) -> CostExpansion:
        """Returns values and derivatives of each step."""


@dataclass(frozen=True)
class FeatureCost:
    """c_t(x, u), dimensionless.

    Attributes:
        features: r.
        targets: r*, shape (m,), or (T, m) where they change with time, in the units of r.
        weights: w, shape (m,) or (T, m).
        smooth: s of each reading whose norm is the smooth absolute value, shape (m,); 0 where the
            norm is e².
        control_weights: w_j, shape (n_u,) [1/(N²·m²) for motors].
    """

    features: Features
    targets: Array
    weights: Array
    smooth: Array
    control_weights: Array

    def __call__(self, states: Array, controls: Array, first: int = 0) -> Array:
        """Returns the cost of each step, shape (..., T).

        Args:
            states: shape (..., T, n_x).
            controls: shape (..., T, n_u).
            first: place of the first step in the task's horizon.
        """
        parts = self.parts(states, controls, first)
        return parts.sum(axis=-1) + (controls**2) @ self.control_weights

    def starting_at(self, first: int, steps: int) -> "FeatureCost":
        """Returns the cost of some steps as one of its own, for a plan that starts on the way."""
        targets, weights = self._at(first, steps)
        return replace(self, targets=targets, weights=weights)

    def parts(self, states: Array, controls: Array, first: int = 0) -> Array:
        """Returns w ρ(r − r*) of each reading, shape (..., T, m); see `__call__`."""
        return self._parts_of(self.features(states, controls), first)

    def rest(self, steps: int, first: int = 0) -> Array:
        """Returns the cost of steps in which all readings and controls are zero, shape (T,)."""
        return self._parts_of(np.zeros((steps, len(self.smooth))), first).sum(axis=-1)

    def values(self, trajectory: Trajectory) -> Array:
        """Returns the cost of each step, shape (T,)."""
        return self(trajectory.states[:-1], trajectory.controls)

    def expand(self, trajectory: Trajectory) -> CostExpansion:
        """Returns values and Gauss-Newton derivatives of each step."""
        states, controls = trajectory.states[:-1], trajectory.controls
        readings, j_x, j_u = self.features.linearize(states, controls)
        targets, weights = self._at(0, len(states))
        e = readings - targets
        root = np.sqrt(e**2 + self.smooth**2)
        smooth = self.smooth > 0.0
        safe = np.where(smooth, root, 1.0)
        slope = weights * np.where(smooth, e / safe, 2 * e)  # w ρ'
        curvature = weights * np.where(smooth, self.smooth**2 / safe**3, 2.0)  # w ρ''
        c_j = curvature[..., None] * j_x
        return CostExpansion(
            c=self._parts_of(readings, 0).sum(axis=-1) + (controls**2) @ self.control_weights,
            c_x=np.einsum("tmx,tm->tx", j_x, slope),
            c_u=np.einsum("tmu,tm->tu", j_u, slope) + 2 * self.control_weights * controls,
            c_xx=np.swapaxes(j_x, 1, 2) @ c_j,
            c_uu=np.swapaxes(j_u, 1, 2) @ (curvature[..., None] * j_u)
            + np.diag(2 * self.control_weights),
            c_ux=np.swapaxes(j_u, 1, 2) @ c_j,
        )

    def _parts_of(self, readings: Array, first: int) -> Array:
        """Returns w ρ(r − r*), shape (..., T, m), for readings (..., T, m)."""
        targets, weights = self._at(first, readings.shape[-2])
        e = readings - targets
        norms = np.where(self.smooth > 0.0, np.sqrt(e**2 + self.smooth**2) - self.smooth, e**2)
        return np.asarray(weights * norms)

    def _at(self, first: int, steps: int) -> tuple[Array, Array]:
        """Returns r* and w of some steps, (T, m), or (m,) where they do not change.

        After the task's horizon, those of its last step but one hold: the last one may be special.
        """
        found = []
        for values in (self.targets, self.weights):
            if values.ndim == 2 and (first, steps) != (0, len(values)):
                at, count = np.arange(first, first + steps), len(values)
                values = values[np.where(at < count, at, max(count - 2, 0))]  # noqa: PLW2901
            found.append(values)
        return found[0], found[1]
