# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Follows a demonstration.

A gait whose torques are replayed without feedback diverges, since rounding errors grow with every
step. A linear-quadratic regulator around the demonstration keeps the rollout close to it,

    minimise  Σ ‖δx‖² + ρ ‖δu‖²,    u = ū + K (x ⊖ x̄).
"""

import numpy as np

from vgps_ros.core.ddp.backward_pass import backward_pass
from vgps_ros.core.dynamics import DynamicsModel
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.records import Array, CostExpansion, Trajectory

CONTROL_WEIGHT = 1e-4  # ρ [1/(N²·m²)]
# As in a solve, μ keeps gains moderate where contact is hard.
REGULARIZATION = 0.1


def track(
    dynamics: DynamicsModel,
    demonstration: Trajectory,
    start: Array,
    names: list[str],
    tolerance: float,
) -> tuple[Trajectory, int]:
    """Returns a rollout that follows a demonstration, and how many simulator steps it took.

    Args:
        dynamics: x' = f(x, u).
        demonstration: x̄, ū.
        start: x_1 near the demonstration's first state, shape (n_x,).
        names: names of the positions among a deviation's coordinates, which come first.
        tolerance: largest deviation of a position that counts as followed [m, rad].

    Raises:
        DivergenceError: the rollout leaves the demonstration; the message says where, in which
            joint and by how much.
    """
    horizon, space, n_u = demonstration.horizon, dynamics.space, dynamics.control_dim
    n_dx = space.tangent_dim
    expansion = CostExpansion(
        c=np.zeros(horizon),
        c_x=np.zeros((horizon, n_dx)),
        c_u=np.zeros((horizon, n_u)),
        c_xx=np.tile(2 * np.eye(n_dx), (horizon, 1, 1)),
        c_uu=np.tile(2 * CONTROL_WEIGHT * np.eye(n_u), (horizon, 1, 1)),
        c_ux=np.zeros((horizon, n_u, n_dx)),
    )
    linear, steps = dynamics.linearize(demonstration)
    gains = backward_pass(linear, expansion, REGULARIZATION).gains
    (rollout,) = dynamics.follow_each(start, [demonstration], gains)
    error = np.abs(space.subtract(rollout.states, demonstration.states))[:, : len(names)]
    away = np.argwhere(~(error <= tolerance))  # written so that NaN counts as away
    if away.size:
        t, i = away[0]
        raise DivergenceError(
            f"The demonstration cannot be followed: at step {t} ({t * dynamics.time_step:.2f} s) "
            f"{names[i]} is {error[t, i]:.3g} away from it, but at most {tolerance:g} is "
            "allowed; check that it was recorded on this model, with these torques."
        )
    return rollout, steps + dynamics.substeps * horizon
