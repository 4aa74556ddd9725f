"""What pictures of a run need, wherever it comes from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.core.records import Array

TRAJECTORIES = "trajectories.npz"  # beside result.json, where a run has no bag


@dataclass(frozen=True)
class RunRecord:
    """A run, or as much of it as is known; what is not known is None.

    Attributes:
        mjcf: the robot.
        time_step: duration of one control step [s].
        result: the content of result.json: the costs of each iteration.
        initial_states: the initial DDP solution's, shape (T+1, n_x).
        mean_states: those that the last q(ζ) is centred on, shape (T+1, n_x).
        state_covariances: of the last q(ζ)'s marginals, shape (T+1, n_x, n_x).
        executed_states: of the robot under the learned policy, shape (N+1, n_x).
    """

    mjcf: str
    time_step: float
    result: dict[str, Any] | None = None
    initial_states: Array | None = None
    mean_states: Array | None = None
    state_covariances: Array | None = None
    executed_states: Array | None = None

    def save_trajectories(self, folder: Path) -> None:
        """Writes the motions that are known, for a run without a bag."""
        arrays = {
            "initial_states": self.initial_states,
            "mean_states": self.mean_states,
            "state_covariances": self.state_covariances,
            "executed_states": self.executed_states,
        }
        known = {name: array for name, array in arrays.items() if array is not None}
        np.savez_compressed(folder / TRAJECTORIES, **known)  # type: ignore[arg-type]
