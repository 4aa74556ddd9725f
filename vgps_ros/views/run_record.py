"""The data of a run that pictures need, read from a bag or from the files of `train`."""

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

# Arrays of a run in trajectories.npz, and the number of dimensions of each.
_MOTIONS = {"initial_states": 2, "mean_states": 2, "state_covariances": 3, "executed_states": 2}
TRAJECTORIES = "trajectories.npz"  # stands beside result.json in a run without a bag


@dataclass(frozen=True)
class RunRecord:
    """Holds a run; parts that are not known are None.

    Attributes:
        mjcf: the robot's MJCF.
        time_step: duration of one control step [s].
        result: the content of result.json, which has the costs of each iteration.
        initial_states: states of the initial DDP solution, shape (T+1, n_x).
        mean_states: states that the last q(ζ) is centred on, shape (T+1, n_x).
        state_covariances: covariances of the last q(ζ)'s marginals, shape (T+1, n_x, n_x).
        executed_states: states of the robot under the learned policy, shape (N+1, n_x).
    """

    mjcf: str
    time_step: float
    result: dict[str, Any] | None = None
    initial_states: Array | None = None
    mean_states: Array | None = None
    state_covariances: Array | None = None
    executed_states: Array | None = None

    def save_trajectories(self, folder: Path) -> None:
        """Writes the known motions to trajectories.npz, for a run without a bag."""
        arrays = {name: getattr(self, name) for name in _MOTIONS}
        known = {name: array for name, array in arrays.items() if array is not None}
        with replacing(folder / TRAJECTORIES) as file:
            np.savez_compressed(file, **known)


def read_results(folder: Path) -> RunRecord:
    """Reads the run that `train` wrote to a folder.

    Raises:
        InvalidInputError: a file is missing or does not fit the task.
    """
    try:
        result = json.loads((folder / "result.json").read_text())
        task = make_task(result["task"])
        n_x = task.dynamics.state_dim
        with np.load(folder / TRAJECTORIES, allow_pickle=False) as file:
            arrays = {
                name: finite_array(name, array := file[name], (len(array), *[n_x] * (ndim - 1)))
                for name, ndim in _MOTIONS.items()
            }
        return RunRecord(
            task.model_path.read_text(), task.dynamics.time_step, result=result, **arrays
        )
    except (OSError, ValueError, KeyError, TypeError, BadZipFile, InvalidInputError) as error:
        raise InvalidInputError(
            f"'{folder}' does not hold what `train` writes for one of {', '.join(sorted(TASKS))}: "
            f"{str(error).rstrip('.')}."
        ) from error
