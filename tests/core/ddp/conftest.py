# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Linear-quadratic problems, for which everything is known in closed form."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import block_diag

from vgps_ros.core.records import Array, ControlBounds, CostExpansion, LinearDynamics, Trajectory


@dataclass(frozen=True)
class LqProblem:
    """x' = A_t x + B_t u with cost ½ zᵀ H_t z + g_tᵀ z, z = (x, u).

    It plays both the dynamics and the cost of a solve, and claims 7 simulator steps for the
    derivatives at a point and 3 for a control.
    """

    substeps = 3

    linear: LinearDynamics
    hessians: Array
    gradients: Array
    limit: float = np.inf

    @property
    def control_limits(self) -> tuple[Array, Array]:
        limits = np.full(self.linear.f_u.shape[2], self.limit)
        return -limits, limits

    def bounds_along(self, states) -> ControlBounds:
        shape = (len(states) - 1, self.linear.f_u.shape[2])
        return ControlBounds(*(np.broadcast_to(end, shape) for end in self.control_limits))

    @property
    def horizon(self) -> int:
        return len(self.gradients)

    @property
    def state_dim(self) -> int:
        return self.linear.f_x.shape[1]

    def rollout(self, initial_state, control_law, horizon, gaps=None) -> Trajectory:
        states, controls = [initial_state], []
        for t in range(horizon):
            control = np.atleast_2d(control_law(t, states[t][None]))[0]
            controls.append(np.clip(control, *self.control_limits))
            after = self.linear.f_x[t] @ states[t] + self.linear.f_u[t] @ controls[t]
            states.append(after if gaps is None else after - gaps[t])
        return Trajectory(np.array(states), np.array(controls))

    def follow_each(self, start, nominals, gains, gaps=None) -> Iterator[Trajectory]:
        for nominal, gap in zip(nominals, gaps or [None] * len(nominals), strict=True):

            def law(t, x, nominal=nominal):
                return nominal.controls[t] + (x - nominal.states[t]) @ gains[t].T

            yield self.rollout(start, law, nominal.horizon, gap)

    def gaps(self, trajectory: Trajectory) -> Array:
        f_x, f_u = self.linear.f_x, self.linear.f_u
        after = np.einsum("txy,ty->tx", f_x, trajectory.states[:-1])
        after += np.einsum("txu,tu->tx", f_u, trajectory.controls)
        return after - trajectory.states[1:]

    def linearize(self, trajectory: Trajectory) -> tuple[LinearDynamics, int]:
        return self.linear, 7 * self.horizon

    def values(self, trajectory: Trajectory) -> Array:
        return self.expand(trajectory).c

    def expand(self, trajectory: Trajectory) -> CostExpansion:
        n = self.state_dim
        z = np.hstack([trajectory.states[:-1], trajectory.controls])
        h_z = np.einsum("tij,tj->ti", self.hessians, z)
        gradient = self.gradients + h_z
        blocks = (
            np.sum(z * (self.gradients + 0.5 * h_z), axis=1),
            gradient[:, :n],
            gradient[:, n:],
            self.hessians[:, :n, :n],
            self.hessians[:, n:, n:],
            self.hessians[:, n:, :n],
        )
        return CostExpansion(*map(np.ascontiguousarray, blocks))

    def optimum(self, start):
        """Minimises the quadratic cost under the dynamics and x_1 = start, as one linear system."""
        horizon, n_x = self.horizon, self.state_dim
        n = self.gradients.shape[1]
        constraints = np.zeros((horizon * n_x, horizon * n))
        for t in range(horizon):
            constraints[t * n_x : (t + 1) * n_x, t * n : t * n + n_x] = np.eye(n_x)
            if t:
                step = np.hstack([self.linear.f_x[t - 1], self.linear.f_u[t - 1]])
                constraints[t * n_x : (t + 1) * n_x, (t - 1) * n : t * n] = -step
        zeros = np.zeros((horizon * n_x, horizon * n_x))
        matrix = np.block([[block_diag(*self.hessians), constraints.T], [constraints, zeros]])
        bounds = np.zeros(horizon * n_x)
        bounds[:n_x] = start
        solution = np.linalg.solve(matrix, np.concatenate([-self.gradients.ravel(), bounds]))
        return np.split(solution[: horizon * n].reshape(horizon, n), [n_x], axis=1)

    def at_rest(self) -> Trajectory:
        """The trajectory in which nothing moves."""
        n_u = self.linear.f_u.shape[2]
        return Trajectory(
            np.zeros((self.horizon + 1, self.state_dim)), np.zeros((self.horizon, n_u))
        )


@pytest.fixture
def lq_problem(rng):
    """Returns a function that draws a convex problem with cross and linear terms."""

    def make(horizon=12, n_x=4, n_u=2, stationary=False) -> LqProblem:
        steps = 1 if stationary else horizon
        roots = rng.standard_normal((steps, n_x + n_u, n_x + n_u))
        arrays = (
            rng.standard_normal((steps, n_x, n_x)) / np.sqrt(n_x),
            rng.standard_normal((steps, n_x, n_u)),
            roots @ np.swapaxes(roots, 1, 2) / n_x + 0.1 * np.eye(n_x + n_u),
            rng.standard_normal((steps, n_x + n_u)),
        )
        f_x, f_u, hessians, gradients = (np.repeat(a, horizon // steps, axis=0) for a in arrays)
        return LqProblem(LinearDynamics(f_x, f_u), hessians, gradients)

    return make
