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
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from vgps_ros.bags.episode import Episode, driven_episodes
from vgps_ros.bags.reader import BagReader
from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import compile_model, state_names
from vgps_ros.storage.files import part_of

_TABLE = "motions.parquet"
_RATE_TOLERANCE = 0.01  # between the time steps of bags, as a share of them


@dataclass
class DataSet:
    """Motions of one robot.

    Attributes:
        mjcf: the robot's MJCF.
        model: the same, compiled.
        state_names: of the numbers of a state.
        control_names: of the controls, such as knee/effort.
        time_step: time between two states [s].
        motions: the motions.
        bags: name of the bag of each motion.
        faults: a sentence on each part of a bag in which states are missing.
    """

    mjcf: str
    model: mujoco.MjModel
    state_names: list[str]
    control_names: list[str]
    time_step: float
    motions: list[Episode] = field(default_factory=list)
    bags: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    @property
    def lengths(self) -> list[int]:
        """Number of steps of each motion."""
        return [len(motion.time) - 1 for motion in self.motions]

    def stacked(self) -> tuple[Array, Array]:
        """Returns states (N, n_x) and controls at the joints (N, n_u) of all steps, in order."""
        states = np.concatenate([motion.states[:-1] for motion in self.motions])
        controls = np.concatenate([motion.controls[1:] for motion in self.motions])
        return states, controls_of(self.model).at_joints(controls)


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
        faults = list[str]()
        with BagReader(path, namespace) as bag:
            mjcf = bag.mjcf()
            model = compile_model(mjcf)
            read = driven_episodes(bag, model, faults)
        step = float(np.median([episode.time_step for episode in read]))
        one = DataSet(mjcf, model, state_names(model), controls_of(model).columns, step)
        found = found or one
        names, others = (set_.state_names + set_.control_names for set_ in (found, one))
        if names != others:
            strange = next(iter(set(names) ^ set(others)), "the order of its joints")
            raise InvalidInputError(
                f"'{path}' is of another robot than the bag before it, by {quote(strange)}; put "
                "the motions of each robot into a data set of their own."
            )
        if abs(step / found.time_step - 1) > _RATE_TOLERANCE:
            raise InvalidInputError(
                f"'{path}' has a state each {step:g} s, but the bag before it each "
                f"{found.time_step:g} s; put them into data sets of their own."
            )
        found.motions.extend(read)
        found.bags.extend([path.name] * len(read))
        found.faults.extend(f"'{path}': {sentence}" for sentence in faults)
    assert found is not None
    return found


@contextmanager
def new_folder(folder: Path, *, overwrite: bool) -> Iterator[Path]:
    """Gives a folder to write into, which takes the place of an empty or a new one at the end.

    That of a data set, too, where it may be overwritten.

    Raises:
        InvalidInputError: the folder holds something else already.
    """
    is_new = not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))
    is_data_set = any((folder / name).is_file() for name in (_TABLE, "meta/info.json"))
    if not (is_new or (is_data_set and overwrite)):
        raise InvalidInputError(
            f"'{folder}' is not an empty folder; name another one"
            f"{', or give --overwrite' * is_data_set}."
        )
    part = part_of(folder.resolve())
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir(parents=True)
        yield part
        if not is_new:
            shutil.rmtree(folder)
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
        "time": np.concatenate([m.start + m.time[:-1] for m in data.motions]),
        **dict(zip(data.state_names, states.T, strict=True)),
        **dict(zip(data.control_names, controls.T, strict=True)),
    }
    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    about = {"mjcf": data.mjcf, "time_step": repr(data.time_step)}
    pa.parquet.write_table(table.replace_schema_metadata(about), folder / _TABLE)
