# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The dynamics x_{t+1} = f(x_t, u_t) of trajectory optimisation, and the space of their states.

`vgps_ros.simulation.dynamics` implements the protocol for MuJoCo models; tests bring others.
States are x = (qpos, qvel, act), and δ are their small changes.

Most coordinates are plain numbers, whose changes are differences. The orientation of a free body
or of a ball joint is a unit quaternion (w, x, y, z): four numbers with three degrees of freedom,
whose change is a rotation vector in the body's own frame. So δ has n_dx ≤ n_x coordinates, and

    x ⊕ δ = x + δ,  but  q exp(δ)  for a quaternion,
    x' ⊖ x = x' − x,  but  log(q⁻¹ q')  for a quaternion,

as MuJoCo's mj_integratePos and mj_differentiatePos have it. Derivatives, gains and covariances are
over δ.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.records import Array, ControlBounds, LinearDynamics, Trajectory

if TYPE_CHECKING:  # an executor takes no SciPy
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class StateSpace:
    """States and their deviations.

    Attributes:
        state_dim: n_x.
        quaternions: index in x of the first number of each unit quaternion, in ascending order.
    """

    state_dim: int
    quaternions: tuple[int, ...] = ()

    @property
    def tangent_dim(self) -> int:
        """n_dx, the number of coordinates of a deviation."""
        return self.state_dim - len(self.quaternions)

    def add(self, states: Array, deviations: Array) -> Array:
        """Returns x ⊕ δ, shape (..., n_x), for x (..., n_x) and δ (..., n_dx)."""
        if not self.quaternions:
            return states + deviations
        states, _ = np.broadcast_arrays(states, deviations[..., :1])
        moved = states.copy()
        moved[..., self.plain[0]] += deviations[..., self.plain[1]]
        for at, rotation in self._rotations(states):
            turned = rotation * _turned(_rows(deviations, at[1], states.shape))
            quaternions = np.roll(turned.as_quat(), 1, axis=-1)
            moved[..., at[0]] = quaternions.reshape(moved[..., at[0]].shape)
        return moved

    def subtract(self, states: Array, origins: Array) -> Array:
        """Returns x' ⊖ x, shape (..., n_dx), for states x' and origins x of shape (..., n_x)."""
        if not self.quaternions:
            return states - origins
        states, origins = np.broadcast_arrays(states, origins)
        deviations = np.empty((*states.shape[:-1], self.tangent_dim))
        deviations[..., self.plain[1]] = (states - origins)[..., self.plain[0]]
        pairs = zip(self._rotations(states), self._rotations(origins), strict=True)
        for (at, rotation), (_, origin) in pairs:
            vectors = (origin.inv() * rotation).as_rotvec()
            deviations[..., at[1]] = vectors.reshape(deviations[..., at[1]].shape)
        return deviations

    def carried_back(
        self, jacobians: Array, deviations: Array, *, by_deviation: bool = False
    ) -> Array:
        """Returns derivatives (..., m, n_dx) at x ⊕ δ as derivatives by x where δ stays, or by δ.

        A rotation ε of x is Rᵀ ε in the frame of x ⊕ δ, where R is the rotation by δ. A change ε of
        δ is J ε there, where J = ∫_0^1 R(s δ)ᵀ ds is the right Jacobian of SO(3).
        """
        if not self.quaternions:
            return jacobians
        carried = jacobians.copy()
        for i, first in enumerate(self.quaternions):
            at = slice(first - i, first - i + 3)
            vectors = _rows(deviations, at, deviations.shape)
            turns = _right_jacobians(vectors) if by_deviation else _turned(-vectors).as_matrix()
            carried[..., at] = jacobians[..., at] @ turns.reshape(*deviations.shape[:-1], 3, 3)
        return carried

    def turns(self, deviations: Array) -> Array:
        """Returns J (..., n_dx, n_dx): a change ε of δ (..., n_dx) is J ε in the frame of x ⊕ δ."""
        eye = np.broadcast_to(np.eye(self.tangent_dim), (*deviations.shape, self.tangent_dim))
        return self.carried_back(eye, deviations, by_deviation=True)

    @cached_property
    def plain(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The indices of the plain numbers in x, and those in δ."""
        in_x, in_dx = np.ones(self.state_dim, bool), np.ones(self.tangent_dim, bool)
        for i, first in enumerate(self.quaternions):
            in_x[first : first + 4] = in_dx[first - i : first - i + 3] = False
        return np.flatnonzero(in_x), np.flatnonzero(in_dx)

    def _rotations(self, states: Array) -> list[tuple[tuple[slice, slice], "Rotation"]]:
        """Returns each rotation of N states, with its places in x and in δ; NaN becomes none."""
        from scipy.spatial.transform import Rotation

        found = []
        for i, first in enumerate(self.quaternions):
            places = slice(first, first + 4), slice(first - i, first - i + 3)
            rows = states[..., places[0]].reshape(-1, 4)
            sound = np.where(np.isfinite(rows).all(axis=1, keepdims=True), rows, [1.0, 0, 0, 0])
            found.append((places, Rotation.from_quat(np.roll(sound, -1, axis=-1))))
        return found


def _turned(vectors: Array) -> "Rotation":
    """Returns the rotations by rotation vectors, one a row."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vectors)


def _right_jacobians(vectors: Array) -> Array:
    """Returns I − (1 − cos θ)/θ² [v] + (1 − sin θ/θ)/θ² [v]², θ = |v|, of each vector (N, 3)."""
    angles = np.linalg.norm(vectors, axis=1)[:, None, None]
    back = np.cross(vectors[:, None], np.eye(3))  # −[v]
    square = (1.0 - np.sinc(angles / np.pi)) / np.maximum(angles, 1e-4) ** 2
    return np.eye(3) + 0.5 * np.sinc(angles / (2.0 * np.pi)) ** 2 * back + square * back @ back


def _rows(deviations: Array, at: slice, shape: tuple[int, ...]) -> Array:
    """Returns a rotation vector for each of the states of this shape, one a row."""
    return np.array(np.broadcast_to(deviations[..., at], (*shape[:-1], 3))).reshape(-1, 3)


# A state beyond this magnitude has diverged [m, rad, m/s, rad/s]; no sound motion comes near it.
DIVERGENCE_BOUND = 1e4

ControlLaw = Callable[[int, Array], Array]
"""Maps the step t and states (N, n_x) to controls (N, n_u), [N·m]."""


class DynamicsModel(Protocol):
    """x' = f(x, u) with its derivatives.

    Attributes:
        space: space of the states.
        control_dim: n_u.
        control_limits: the lowest and the highest control, shapes (n_u,), [N·m]; ∓inf where
            there is no limit. Every rollout clips its controls to them, and records what is
            left, so that a cost is that of what is applied.
        time_step: time for which one control is held [s].
        substeps: simulator steps in that time.
    """

    space: StateSpace
    control_dim: int
    control_limits: tuple[Array, Array]
    time_step: float
    substeps: int

    def follow_each(
        self,
        start: Array,
        nominals: Sequence[Trajectory],
        gains: Array,
        gaps: Sequence[Array | None] | None = None,
    ) -> Iterator[Trajectory]:
        """Yields the rollout of u = ū + K (x ⊖ x̄) from x_1 for each of several x̄, ū, in order.

        Args:
            start: x_1, shape (n_x,).
            nominals: x̄, ū of each; a rollout is NaN from where it diverges on.
            gains: K, shape (T, n_u, n_dx), of all.
            gaps: d of each, shape (T, n_dx), by which it stays short of the dynamics,
                x_{t+1} = f(x_t, u_t) ⊕ (−d_t); None for none, as in a rollout of the robot.
        """

    def bounds_along(self, states: Array) -> ControlBounds:
        """Returns the controls to use in each step from states (T+1, n_x): limits, or less."""

    def linearize(self, trajectory: Trajectory) -> tuple[LinearDynamics, int]:
        """Returns f_x, f_u along a trajectory, and how many simulator steps they took."""
