"""Trajectory distributions, one for each initial state, as .npz; loading them can run no code."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vgps_ros.core.arrays import array_shapes, arrays_of, from_arrays
from vgps_ros.core.checks import check_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.storage.files import read_archive, write_archive


def save_distributions(
    distributions: Sequence[TrajectoryDistribution], task: str, path: Path
) -> None:
    """Writes distributions of one horizon in one piece; they are read back bit for bit."""
    found = [arrays_of(q) for q in distributions]
    stacked = {_key(name): np.stack([arrays[name] for arrays in found]) for name in found[0]}
    write_archive(path, {"task": np.array(task), **stacked})


def load_distributions(path: Path) -> tuple[list[TrajectoryDistribution], str]:
    """Reads distributions and the name of their task.

    Raises:
        InvalidInputError: the file is missing, holds no distributions, or its arrays do not fit.
    """
    try:
        file = read_archive(path)
        (count, horizon, n_u), n_x = file["controls"].shape, file["states"].shape[-1]
        shapes = array_shapes(TrajectoryDistribution, T=horizon, n_x=n_x, n_u=n_u)
        arrays = {name: file[_key(name)].astype(float) for name in shapes}
        for name, shape in shapes.items():
            check_array(_key(name), arrays[name], (count, *shape))
        task = str(file["task"])
    except OSError as error:
        raise InvalidInputError(f"{path} is not a readable distribution file: {error}.") from error
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InvalidInputError(f"{path} holds no distributions of vgps_ros: {error}.") from error
    return [
        from_arrays(TrajectoryDistribution, {name: arrays[name][i] for name in shapes})
        for i in range(count)
    ], task


def _key(name: str) -> str:
    """Returns an array's name in the file, which is that of its own record's field."""
    return name.rpartition(".")[2]
