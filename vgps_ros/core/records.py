# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Frozen records that the parts of the method hand to each other.

Indices run over steps first: `states[t]` is x_{t+1} of the paper, which counts from 1. A trajectory
of T controls has T + 1 states; the last one carries no cost. The shape of an array stands where its
field is declared, and files, messages and checks derive from there. Derivatives, gains and
covariances are over deviations of the state, of which there are n_dx (see `state_space`).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

from vgps_ros.core.checks import Array, Shape, first_steps
from vgps_ros.core.gaussians import covariance_roots


@dataclass(frozen=True)
class Trajectory:
    """A sequence of states and controls.

    Attributes:
        states: positions [m, rad, quaternions], velocities [m/s, rad/s], then activations.
        controls: of the actuators, each in its own unit.
    """

    states: Annotated[Array, Shape("T+1", "n_x")]
    controls: Annotated[Array, Shape("T", "n_u")]

    @property
    def horizon(self) -> int:
        """T, the number of controls."""
        return len(self.controls)

    def first(self, steps: int) -> "Trajectory":
        """Returns the first steps."""
        return first_steps(self, steps)


@dataclass(frozen=True)
class LinearDynamics:
    """Derivatives of x' = f(x, u) along a trajectory, over deviations."""

    f_x: Annotated[Array, Shape("T", "n_dx", "n_dx")]
    f_u: Annotated[Array, Shape("T", "n_dx", "n_u")]


@dataclass(frozen=True)
class ControlBounds:
    """The controls that act on the robot along a trajectory: lowest ≤ u ≤ highest.

    Attributes:
        slopes: derivatives of both bounds by the state; None where no bound depends on it.
    """

    lowest: Annotated[Array, Shape("T", "n_u")]
    highest: Annotated[Array, Shape("T", "n_u")]
    slopes: Annotated[Array, Shape("2", "T", "n_u", "n_dx")] | None = None


@dataclass(frozen=True)
class CostExpansion:
    """Value, gradient and Hessian of a cost along a trajectory (section 4)."""

    c: Annotated[Array, Shape("T")]
    c_x: Annotated[Array, Shape("T", "n_dx")]
    c_u: Annotated[Array, Shape("T", "n_u")]
    c_xx: Annotated[Array, Shape("T", "n_dx", "n_dx")]
    c_uu: Annotated[Array, Shape("T", "n_u", "n_u")]
    c_ux: Annotated[Array, Shape("T", "n_u", "n_dx")]


@dataclass(frozen=True)
class TrajectoryDistribution:
    """The Gaussian q(ζ) of section 4, centred on an executed trajectory.

    Attributes:
        mean: x̄, ū.
        gains: K_t, in units of the controls per unit of the state.
        control_covariances: Quu_t⁻¹, in squares of their units.
        linear_dynamics: f_x, f_u around the mean.
        state_covariances: Σ_t of the marginals q(x_t).
        context: z_t, the commands and the clock that q was optimised for; n_z is often 0.
    """

    mean: Trajectory
    gains: Annotated[Array, Shape("T", "n_u", "n_dx")]
    control_covariances: Annotated[Array, Shape("T", "n_u", "n_u", is_covariance=True)]
    linear_dynamics: LinearDynamics
    state_covariances: Annotated[Array, Shape("T+1", "n_dx", "n_dx", is_covariance=True)]
    context: Annotated[Array, Shape("T", "n_z")]

    @cached_property
    def state_roots(self) -> Array:
        """R_t with R_t R_tᵀ = Σ_t at t = 1 … T, shape (T, n_dx, n_dx)."""
        return covariance_roots(self.state_covariances[: self.mean.horizon])

    def first(self, steps: int) -> "TrajectoryDistribution":
        """Returns the distribution over the first steps."""
        return first_steps(self, steps)
