# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The dynamics that trajectory optimisation works on, x_{t+1} = f(x_t, u_t), as a protocol.

`vgps_ros.simulation.dynamics` implements it for MuJoCo models; tests bring others.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

from vgps_ros.core.records import Array, LinearDynamics, Trajectory
from vgps_ros.core.state_space import StateSpace

# A state beyond this magnitude has diverged [m, rad, m/s, rad/s]; no sound motion comes near it.
DIVERGENCE_BOUND = 1e4
# A control beyond it has diverged [N·m]; MuJoCo replaces one beyond 1e10 by zero and would hide it.
CONTROL_BOUND = 1e9

ControlLaw = Callable[[int, Array], Array]
"""Maps the step t and states (N, n_x) to controls (N, n_u), [N·m]."""


class Dynamics(Protocol):
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

    def linearize(self, trajectory: Trajectory) -> tuple[LinearDynamics, int]:
        """Returns f_x, f_u along a trajectory, and how many simulator steps they took."""
