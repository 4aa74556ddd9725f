# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The data of a run that pictures need, read from a bag or from the files of `train`."""

from dataclasses import dataclass
from typing import Annotated, Any

from vgps_ros.core.checks import Array, Shape, array_shapes, finite_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.search.commanded_motion import CommandedMotion
from vgps_ros.storage.files import read_archive
from vgps_ros.storage.run_folder import RunFolder, read_result
from vgps_ros.tasks import recorded_task


@dataclass(frozen=True)
class RunRecord:
    """Holds a run; parts that are not known are None.

    Attributes:
        mjcf: the robot's MJCF.
        time_step: duration of one control step [s].
        result: the content of result.json, which has the metrics of each iteration.
        initial_states: states of the initial DDP solution.
        mean_states: states that the last q(ζ) is centred on.
        state_covariances: covariances of the last q(ζ)'s marginals.
        executed_states: states of the robot under the learned policy, over N steps.
        driven: what the robot was told in that motion, and what it did of it.
        faults: a sentence on each part of the bag that is damaged, or in which states are missing.
    """

    mjcf: str
    time_step: float
    result: dict[str, Any] | None = None
    initial_states: Annotated[Array | None, Shape("T+1", "n_x")] = None
    mean_states: Annotated[Array | None, Shape("T+1", "n_x")] = None
    state_covariances: Annotated[Array | None, Shape("T+1", "n_dx", "n_dx")] = None
    executed_states: Annotated[Array | None, Shape("N+1", "n_x")] = None
    driven: CommandedMotion | None = None
    faults: tuple[str, ...] = ()


def read_results(folder: RunFolder) -> RunRecord:
    """Reads the run that `train` wrote to a folder.

    Raises:
        InvalidInputError: a file is missing or does not fit the task.
    """
    try:
        result = read_result(folder.result)
        task = recorded_task(result["task"])
        found = read_archive(folder.trajectories)
        steps = {"T": len(found["mean_states"]) - 1, "N": len(found["executed_states"]) - 1}
        shapes = array_shapes(RunRecord, **steps, **task.dims)
        arrays: dict[str, Any] = {n: finite_array(n, found[n], s) for n, s in shapes.items()}
        return RunRecord(task.mjcf, task.dynamics.time_step, result=result, **arrays)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidInputError(
            f"'{folder.path}' does not hold what `train` writes for a task: "
            f"{str(error).rstrip('.')}."
        ) from error
