# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The cost to go of a motion that is followed with feedback, to second order."""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.records import Array, CostExpansion, LinearDynamics


@dataclass(frozen=True)
class CostToGo:
    """V_t(x) = V_t(x̄_t) + V_xᵀ δx + ½ δxᵀ V_xx δx from each step to the end, less V_t(x̄_t).

    Attributes:
        v_x: V_x, shape (T, n_dx).
        v_xx: V_xx, shape (T, n_dx, n_dx).
    """

    v_x: Array
    v_xx: Array

    def __call__(self, t: int, deviation: Array) -> float:
        """Returns V_t(x̄_t ⊕ δx) − V_t(x̄_t) for a deviation (n_dx,)."""
        return float(self.v_x[t] @ deviation + 0.5 * deviation @ self.v_xx[t] @ deviation)


def cost_to_go(dynamics: LinearDynamics, cost: CostExpansion, gains: Array) -> CostToGo:
    """Returns the cost to go along a trajectory under δu = K δx.

    Args:
        dynamics: f_x, f_u of each step.
        cost: expansion of each step's cost; the state after the last step has no cost.
        gains: K, shape (T, n_u, n_dx).
    """
    v_x, v_xx = np.zeros_like(cost.c_x), np.zeros_like(cost.c_xx)
    next_x, next_xx = np.zeros_like(v_x[0]), np.zeros_like(v_xx[0])
    for t in reversed(range(len(v_x))):
        k = gains[t]
        a = dynamics.f_x[t] + dynamics.f_u[t] @ k  # of the closed loop
        v_x[t] = cost.c_x[t] + k.T @ cost.c_u[t] + a.T @ next_x
        crossed = cost.c_ux[t].T @ k
        v_xx[t] = cost.c_xx[t] + crossed + crossed.T + k.T @ cost.c_uu[t] @ k + a.T @ next_xx @ a
        next_x, next_xx = v_x[t], v_xx[t]
    return CostToGo(v_x, v_xx)
