"""Frozen records that the parts of the method hand to each other.

Indices run over steps first: `states[t]` is x_{t+1} of the paper, which counts from 1. A trajectory
of T controls has T + 1 states; the last one carries no cost.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """A sequence of states and controls.

    Attributes:
        states: shape (T+1, n_x), generalized positions [m, rad], then velocities [m/s, rad/s].
        controls: shape (T, n_u), [N·m].
    """

    states: Array
    controls: Array

    @property
    def horizon(self) -> int:
        """T, the number of controls."""
        return len(self.controls)

    def first(self, steps: int) -> "Trajectory":
        """Returns the first steps."""
        return Trajectory(self.states[: steps + 1], self.controls[:steps])


@dataclass(frozen=True)
class LinearDynamics:
    """Derivatives of x' = f(x, u) along a trajectory.

    Attributes:
        f_x: shape (T, n_x, n_x).
        f_u: shape (T, n_x, n_u).
    """

    f_x: Array
    f_u: Array


@dataclass(frozen=True)
class CostExpansion:
    """Second-order expansion of a cost along a trajectory (section 4).

    Attributes:
        c: shape (T,), values.
        c_x: shape (T, n_x).
        c_u: shape (T, n_u).
        c_xx: shape (T, n_x, n_x).
        c_uu: shape (T, n_u, n_u).
        c_ux: shape (T, n_u, n_x).
    """

    c: Array
    c_x: Array
    c_u: Array
    c_xx: Array
    c_uu: Array
    c_ux: Array


@dataclass(frozen=True)
class TrajectoryDistribution:
    """The Gaussian q(ζ) of section 4, centred on an executed trajectory.

    Attributes:
        mean: x̄, ū.
        gains: K_t, shape (T, n_u, n_x).
        control_covariances: Quu_t⁻¹, shape (T, n_u, n_u), [N²·m²].
        linear_dynamics: f_x, f_u around the mean.
        state_covariances: Σ_t of the marginals q(x_t), shape (T+1, n_x, n_x).
    """

    mean: Trajectory
    gains: Array
    control_covariances: Array
    linear_dynamics: LinearDynamics
    state_covariances: Array

    @cached_property
    def state_roots(self) -> Array:
        """R_t with R_t R_tᵀ = Σ_t at t = 1 … T, shape (T, n_x, n_x)."""
        eigenvalues, eigenvectors = np.linalg.eigh(self.state_covariances[: self.mean.horizon])
        # Σ may be singular (a noise-free coordinate), where Cholesky would fail.
        return eigenvectors * np.sqrt(np.maximum(eigenvalues, 0.0))[:, None, :]

    def first(self, steps: int) -> "TrajectoryDistribution":
        """Returns the distribution over the first steps."""
        return TrajectoryDistribution(
            self.mean.first(steps),
            self.gains[:steps],
            self.control_covariances[:steps],
            LinearDynamics(self.linear_dynamics.f_x[:steps], self.linear_dynamics.f_u[:steps]),
            self.state_covariances[: steps + 1],
        )
