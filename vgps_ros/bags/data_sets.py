# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Data sets of the motions in bags, as one table of Parquet that any data library reads.

Each row is a step: the state, and the control that was chosen in it. A motion ends where time goes
back and where states are missing; its last state has no control, and so no row. `lerobot_format`
writes the same motions as LeRobot reads them.
"""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from vgps_ros.bags.episode import episodes, holes, motion_of
from vgps_ros.bags.reader import BagReader
from vgps_ros.core.checks import quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import compile_model, state_names
from vgps_ros.storage.files import part_of

_RATE_TOLERANCE = 0.01  # between the time steps of bags, as a share of them


@dataclass(frozen=True)
class DataSet:
    """Motions of one robot.

    Attributes:
        mjcf: the robot's MJCF.
        model: the same, compiled.
        time_step: time between two states [s].
        motions: the motions.
        times: stamp of each state of each motion but its last, shape (T,) [s].
        bags: name of the bag of each motion.
        faults: a sentence on each part of a bag that is damaged, or in which states are missing.
    """

    mjcf: str
    model: mujoco.MjModel
    time_step: float
    motions: tuple[Trajectory, ...]
    times: tuple[Array, ...]
    bags: tuple[str, ...]
    faults: tuple[str, ...]

    @property
    def state_names(self) -> list[str]:
        """Names of the numbers of a state."""
        return state_names(self.model)

    @property
    def control_names(self) -> list[str]:
        """Names of the controls, such as knee/effort."""
        return controls_of(self.model).columns

    @property
    def lengths(self) -> list[int]:
        """Number of steps of each motion."""
        return [motion.horizon for motion in self.motions]

    def stacked(self) -> tuple[Array, Array]:
        """Returns states (N, n_x) and controls at the joints (N, n_u) of all steps, in order."""
        return (
            np.concatenate([motion.states[:-1] for motion in self.motions]),
            controls_of(self.model).at_joints(np.concatenate([m.controls for m in self.motions])),
        )


def read_data_set(bags: Sequence[Path], namespace: str | None = None) -> DataSet:
    """Reads all motions of bags.

    Args:
        bags: folders of bags of one robot.
        namespace: of the robot that is meant, for bags of several.

    Raises:
        InvalidInputError: a bag cannot be read, has no motion, or is of another robot or rate.
    """
    found: DataSet | None = None
    for path in bags:
        with BagReader(path, namespace) as bag:
            mjcf = bag.mjcf()
            model = compile_model(mjcf)
            read = episodes(bag, model)
        if not read:
            raise InvalidInputError(f"'{path}' has no motion: it needs two states at least.")
        step = float(np.median([episode.time_step for episode in read]))
        motions = tuple(motion_of(episode) for episode in read)
        times = tuple(episode.start + episode.time[:-1] for episode in read)
        faults = tuple(f"'{path}': {sentence}" for sentence in (*bag.damages, *holes(read)))
        one = DataSet(mjcf, model, step, motions, times, (path.name,) * len(motions), faults)
        found = _joined(found, one, path) if found else one
    assert found is not None
    return found


def _joined(first: DataSet, other: DataSet, path: Path) -> DataSet:
    names = [set_.state_names + set_.control_names for set_ in (first, other)]
    if names[0] != names[1]:
        strange = next(iter(set(names[0]) ^ set(names[1])), "the order of its joints")
        raise InvalidInputError(
            f"'{path}' is of another robot than the bag before it, by {quoted(strange)}; put the "
            "motions of each robot into a data set of their own."
        )
    if abs(other.time_step / first.time_step - 1) > _RATE_TOLERANCE:
        raise InvalidInputError(
            f"'{path}' has a state each {other.time_step:g} s, but the bag before it each "
            f"{first.time_step:g} s; put them into data sets of their own."
        )
    return replace(
        first,
        motions=first.motions + other.motions,
        times=first.times + other.times,
        bags=first.bags + other.bags,
        faults=first.faults + other.faults,
    )


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Gives a folder to write into, which takes the place of an empty or a new one at the end.

    Raises:
        InvalidInputError: the folder holds something already.
    """
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise InvalidInputError(f"'{folder}' is not an empty folder; name another one.")
    part = part_of(folder.resolve())
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir(parents=True)
        yield part
        os.replace(part, folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def write_parquet(data: DataSet, folder: Path) -> None:
    """Writes motions.parquet: bag, episode, time of the state's stamp [s], state and controls."""
    import pyarrow as pa
    import pyarrow.parquet

    states, controls = data.stacked()
    columns = {
        "bag": np.repeat(data.bags, data.lengths),
        "episode": np.repeat(np.arange(len(data.motions)), data.lengths),
        "time": np.concatenate(data.times),
        **dict(zip(data.state_names, states.T, strict=True)),
        **dict(zip(data.control_names, controls.T, strict=True)),
    }
    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    about = {"mjcf": data.mjcf, "time_step": repr(data.time_step)}
    pa.parquet.write_table(table.replace_schema_metadata(about), folder / "motions.parquet")
