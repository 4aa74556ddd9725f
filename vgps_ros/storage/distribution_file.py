"""Trajectory distributions, one for each initial state, as .npz; loading them can run no code."""

import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from vgps_ros.core.checks import check_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, LinearDynamics, Trajectory, TrajectoryDistribution
from vgps_ros.storage.files import replacing

DISTRIBUTION = "distribution.npz"

# What NumPy raises of a file that is no archive, lacks an array, or has one of another kind. A
# single array instead of an archive is no context manager.
_MALFORMED = (
    *(zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, MemoryError),
    *(KeyError, IndexError, AttributeError, TypeError, ValueError),
)


def save_distributions(
    distributions: Sequence[TrajectoryDistribution], task: str, path: Path
) -> None:
    """Writes distributions of one horizon in one piece; they are read back bit for bit."""

    def stack(array_of: Callable[[TrajectoryDistribution], Array]) -> Array:
        return np.stack([array_of(q) for q in distributions])

    with replacing(path) as file:
        np.savez(
            file,
            task=np.array(task),
            states=stack(lambda q: q.mean.states),
            controls=stack(lambda q: q.mean.controls),
            gains=stack(lambda q: q.gains),
            control_covariances=stack(lambda q: q.control_covariances),
            f_x=stack(lambda q: q.linear_dynamics.f_x),
            f_u=stack(lambda q: q.linear_dynamics.f_u),
            state_covariances=stack(lambda q: q.state_covariances),
        )


def load_distributions(path: Path) -> tuple[list[TrajectoryDistribution], str]:
    """Reads distributions and the name of their task.

    Raises:
        InvalidInputError: the file is missing, holds no distributions, or its arrays do not fit.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            task = str(file["task"])
            arrays = {name: file[name].astype(float) for name in file.files if name != "task"}
        (count, horizon, n_u), n_x = arrays["controls"].shape, arrays["states"].shape[-1]
        for name, shape in {
            "states": (horizon + 1, n_x),
            "controls": (horizon, n_u),
            "gains": (horizon, n_u, n_x),
            "control_covariances": (horizon, n_u, n_u),
            "f_x": (horizon, n_x, n_x),
            "f_u": (horizon, n_x, n_u),
            "state_covariances": (horizon + 1, n_x, n_x),
        }.items():
            check_array(name, arrays[name], (count, *shape))
    except OSError as error:
        raise InvalidInputError(f"{path} is not a readable distribution file: {error}.") from error
    except _MALFORMED as error:
        raise InvalidInputError(f"{path} holds no distributions of vgps_ros: {error}.") from error
    distributions = [
        TrajectoryDistribution(
            Trajectory(arrays["states"][i], arrays["controls"][i]),
            arrays["gains"][i],
            arrays["control_covariances"][i],
            LinearDynamics(arrays["f_x"][i], arrays["f_u"][i]),
            arrays["state_covariances"][i],
        )
        for i in range(count)
    ]
    return distributions, task
