"""What pictures of a run need, wherever it comes from."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from vgps_ros.core.checks import finite_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.storage.files import replacing
from vgps_ros.tasks import TASKS, make_task

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
        with replacing(folder / TRAJECTORIES) as file:
            np.savez_compressed(file, **known)  # type: ignore[arg-type]


def read_results(folder: Path) -> RunRecord:
    """Returns the run whose results `train` left in a folder.

    Raises:
        InvalidInputError: they are not there, or do not fit the task.
    """
    try:
        result = json.loads((folder / "result.json").read_text())
        task = make_task(result["task"])
        n_x = task.dynamics.state_dim
        with np.load(folder / TRAJECTORIES, allow_pickle=False) as file:
            covariances = file["state_covariances"]
            arrays = {
                "state_covariances": finite_array(
                    "state_covariances", covariances, (len(covariances), n_x, n_x)
                )
            }
            for name in ("initial_states", "mean_states", "executed_states"):
                arrays[name] = finite_array(name, file[name], (len(file[name]), n_x))
        return RunRecord(
            task.model_path.read_text(), task.dynamics.time_step, result=result, **arrays
        )
    except (OSError, ValueError, KeyError, TypeError, BadZipFile, InvalidInputError) as error:
        raise InvalidInputError(
            f"'{folder}' does not hold what `train` writes for one of {', '.join(sorted(TASKS))}: "
            f"{str(error).rstrip('.')}."
        ) from error
