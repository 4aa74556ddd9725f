# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The form of cost that all tasks share, and the protocol that DDP needs of any cost.

    c_t(x, u) = Σ_i w_ti ρ_i(r_i(x, u) − r*_ti) + Σ_j w_j (u_j − u*_j)²

where r are readings of the state, such as a velocity or a height, and ρ is a norm: e², or the
smooth absolute value √(e² + s²) − s, which grows only linearly for |e| above s. Gauss-Newton's
Hessian, Σ w ρ'' Jᵀ J with J = ∂r/∂δ, is never indefinite.

A target may follow the context z_t, the commands and the clock of a step, which are known ahead,
and a weight may count only while a command is not at rest, m_t = 1, or only while all are, m_t = 0,
or only while a foot does not swing:

    r*_t = base_t + A z_t + max(0, B z_t),
    w_t = base_t · m_t, or base_t · (1 − m_t), or base_t · max(0, C z_t).
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

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
class Following:
    """Lets targets and weights follow the context.

    Attributes:
        linear: A, shape (m, n_z).
        lifted: B, shape (m, n_z), which lifts a target and never lowers it, as a swinging foot's.
        moving: factor on each weight while m is 1, shape (m,), 0 or 1.
        still: factor on each weight while m is 0, shape (m,), 0 or 1.
        stance: C, shape (m, n_z); a row of zeros leaves a weight as it is.
        rest: the commands at rest, the first numbers of z, shape (n_c,).
    """

    linear: Array
    lifted: Array
    moving: Array
    still: Array
    stance: Array
    rest: Array

    def added(self, context: Array) -> Array:
        """Returns what the contexts (..., n_z) add to the targets, shape (..., m)."""
        return np.asarray(context @ self.linear.T + np.maximum(context @ self.lifted.T, 0.0))

    def factors(self, context: Array) -> Array:
        """Returns the factors on the weights in contexts (..., n_z), shape (..., m)."""
        commands = context[..., : len(self.rest)]
        moves = (commands != self.rest).any(axis=-1, keepdims=True)
        while_down = np.where(self._stands, np.maximum(context @ self.stance.T, 0.0), 1.0)
        return while_down * np.where(moves, self.moving, self.still)

    @property
    def _stands(self) -> NDArray[np.bool_]:
        return np.asarray((self.stance != 0.0).any(axis=1))

    @property
    def follows(self) -> NDArray[np.bool_]:
        """Tells whether target or weight of each reading changes with the context, shape (m,)."""
        targets = ((self.linear != 0.0) | (self.lifted != 0.0)).any(axis=1)
        return np.asarray(targets | (self.moving != self.still) | self._stands)


@dataclass(frozen=True)
class FeatureCost:
    """c_t(x, u), dimensionless.

    Attributes:
        features: r.
        targets: the base of r*, shape (m,), or (T, m) where it changes with time, in the units of
            r.
        weights: w, shape (m,) or (T, m).
        smooth: s of each reading whose norm is the smooth absolute value, shape (m,); 0 where the
            norm is e².
        control_weights: w_j, shape (n_u,) [1/(N²·m²) for motors].
        control_targets: u*_j, shape (n_u,), [N·m] for motors.
        following: how the targets follow the context; None where they do not.
        context: z of each step, shape (T, n_z); None where no target follows it.
    """

    features: Features
    targets: Array
    weights: Array
    smooth: Array
    control_weights: Array
    control_targets: Array | float = 0.0
    following: Following | None = None
    context: Array | None = None

    def __call__(self, states: Array, controls: Array, first: int = 0) -> Array:
        """Returns the cost of each step, shape (..., T).

        Args:
            states: shape (..., T, n_x).
            controls: shape (..., T, n_u).
            first: place of the first step in the task's horizon.
        """
        parts = self.parts(states, controls, first)
        return parts.sum(axis=-1) + self._of_controls(controls)

    def in_context(self, context: Array) -> "FeatureCost":
        """Returns the cost where the context of the steps is z, shape (T, n_z)."""
        return replace(self, context=context) if self.following else self

    def starting_at(self, first: int, steps: int) -> "FeatureCost":
        """Returns the cost of some steps as one of its own, for a plan that starts on the way."""
        targets, weights = self._at(first, steps)
        return replace(self, targets=targets, weights=weights, following=None, context=None)

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
            c=self._parts_of(readings, 0).sum(axis=-1) + self._of_controls(controls),
            c_x=np.einsum("tmx,tm->tx", j_x, slope),
            c_u=np.einsum("tmu,tm->tu", j_u, slope)
            + 2 * self.control_weights * (controls - self.control_targets),
            c_xx=np.swapaxes(j_x, 1, 2) @ c_j,
            c_uu=np.swapaxes(j_u, 1, 2) @ (curvature[..., None] * j_u)
            + np.diag(2 * self.control_weights),
            c_ux=np.swapaxes(j_u, 1, 2) @ c_j,
        )

    def _of_controls(self, controls: Array) -> Array:
        """Returns Σ_j w_j (u_j − u*_j)², shape (..., T), of controls (..., T, n_u)."""
        return np.asarray(((controls - self.control_targets) ** 2) @ self.control_weights)

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
        targets, weights = (_rows(values, first, steps) for values in (self.targets, self.weights))
        if self.following:
            assert self.context is not None  # `in_context` comes first
            context = _rows(self.context, first, steps)
            targets = targets + self.following.added(context)
            weights = weights * self.following.factors(context)
        return targets, weights


def _rows(values: Array, first: int, steps: int) -> Array:
    """Returns the rows of some steps; values (m,) are those of each step."""
    if values.ndim == 1 or (first, steps) == (0, len(values)):
        return values
    at, count = np.arange(first, first + steps), len(values)
    return values[np.where(at < count, at, max(count - 2, 0))]
