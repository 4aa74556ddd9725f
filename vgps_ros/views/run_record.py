"""Records of a run, which pictures are drawn from, whether it left a bag or files."""

from dataclasses import dataclass
from typing import Annotated, Any

from vgps_ros.core.arrays import Array, Shape, array_shapes, arrays_of
from vgps_ros.core.checks import finite_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.files import read_archive, write_archive
from vgps_ros.storage.run_folder import RunFolder, read_result
from vgps_ros.tasks import TASKS, make_task


@dataclass(frozen=True)
class RunRecord:
    """A run, or as much of it as is known; what is not known is None.

    Attributes:
        mjcf: the robot.
        time_step: duration of one control step [s].
        result: the content of result.json: the metrics of each iteration.
        initial_states: the initial DDP solution's.
        mean_states: those that the last q(ζ) is centred on.
        state_covariances: of the last q(ζ)'s marginals.
        executed_states: of the robot under the learned policy, over N steps.
    """

    mjcf: str
    time_step: float
    result: dict[str, Any] | None = None
    initial_states: Annotated[Array | None, Shape("T+1", "n_x")] = None
    mean_states: Annotated[Array | None, Shape("T+1", "n_x")] = None
    state_covariances: Annotated[Array | None, Shape("T+1", "n_x", "n_x")] = None
    executed_states: Annotated[Array | None, Shape("N+1", "n_x")] = None

    def save_trajectories(self, folder: RunFolder) -> None:
        """Writes the motions that are known, for a run without a bag."""
        known = {name: values for name, values in arrays_of(self).items() if values is not None}
        write_archive(folder.trajectories, known)


def read_results(folder: RunFolder) -> RunRecord:
    """Returns the run whose results `train` left in a folder.

    Raises:
        InvalidInputError: they are not there, or do not fit the task.
    """
    try:
        result = read_result(folder.result)
        task = make_task(result["task"])
        found = read_archive(folder.trajectories)
        sizes = {"T": len(found["mean_states"]) - 1, "N": len(found["executed_states"]) - 1}
        shapes = array_shapes(RunRecord, **sizes, n_x=task.dynamics.state_dim)
        arrays = {name: finite_array(name, found[name], shape) for name, shape in shapes.items()}
        return RunRecord(
            task.model_path.read_text(), task.dynamics.time_step, result=result, **arrays
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidInputError(
            f"'{folder.path}' does not hold what `train` writes for one of "
            f"{', '.join(sorted(TASKS))}: {str(error).rstrip('.')}."
        ) from error
