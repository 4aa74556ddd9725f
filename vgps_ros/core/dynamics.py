"""The dynamics that trajectory optimisation works on, x_{t+1} = f(x_t, u_t), as a protocol.

The simulation of a MuJoCo model is one implementation (`vgps_ros.simulation.dynamics`); a test may
bring another.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

from vgps_ros.core.records import Array, LinearDynamics, Trajectory

# A state beyond this magnitude has diverged: neither metres nor radians per second get there.
DIVERGENCE_BOUND = 1e4
# MuJoCo replaces a control beyond 1e10 by zero, and so would hide that it diverged [N·m].
CONTROL_BOUND = 1e9

ControlLaw = Callable[[int, Array], Array]
"""Maps the step t and states (N, n_x) to controls (N, n_u), [N·m]."""


class Dynamics(Protocol):
    """x' = f(x, u) with its derivatives.

    Attributes:
        state_dim: n_x.
        control_dim: n_u.
        time_step: for which one control is held [s].
        substeps: simulator steps in that time.
    """

    state_dim: int
    control_dim: int
    time_step: float
    substeps: int

    def follow(self, start: Array, nominal: Trajectory, gains: Array) -> Trajectory:
        """Returns the rollout of u = ū + K (x − x̄) from x_1, NaN from where it diverges.

        Args:
            start: x_1, shape (n_x,).
            nominal: x̄, ū.
            gains: K, shape (T, n_u, n_x).
        """

    def follow_each(
        self, start: Array, nominals: Sequence[Trajectory], gains: Array
    ) -> Iterator[Trajectory]:
        """Yields the same for several nominal trajectories, in order."""

    def linearize(self, trajectory: Trajectory) -> tuple[LinearDynamics, int]:
        """Returns f_x, f_u along a trajectory, and how many simulator steps they took."""
