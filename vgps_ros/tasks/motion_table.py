# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Tables of recorded motions.

The file is a table of comma-separated values with a header, one row a step of the task:

    time, JOINT/position and JOINT/velocity of each joint, JOINT/effort of each actuated joint

in seconds, metres and radians, their rates, and N·m; columns may come in any order. A row's efforts
act until the next row; those of the last row are not used. A servo has JOINT/position_target or
JOINT/velocity_target in place of its effort.
"""

import csv
import io
from pathlib import Path

import mujoco
import numpy as np

from vgps_ros.core.checks import finite_array, nearest, quote
from vgps_ros.core.dynamics import DIVERGENCE_BOUND
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.robot.controls import CONTROL_BOUND
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import state_names
from vgps_ros.storage.files import read_file, replacing
from vgps_ros.tasks.task import Task


def read_rows(path: Path) -> tuple[list[str], Array]:
    """Returns the header and the rows, shape (rows, columns).

    Raises:
        InvalidInputError: the file is not readable as a table of numbers.
    """
    try:
        header, *rows = csv.reader(io.StringIO(read_file(path).decode(), newline=""))
        names = [name.strip() for name in header]
        return names, np.array(rows, dtype=float).reshape(len(rows), len(names))
    except (OSError, ValueError, csv.Error) as error:
        raise InvalidInputError(f"{path} is not a readable table of numbers: {error}.") from error


def read_columns(path: Path, names: list[str], times: Array) -> Array:
    """Returns the named columns at some times, linear between rows, shape (times, names).

    Before the first row and after the last one, their values hold.

    Raises:
        InvalidInputError: a column is missing, or time does not increase.
    """
    header, rows = read_rows(path)
    for name in ("time", *names):
        if name not in header:
            raise InvalidInputError(
                f"{path.name} has no column {quote(name)}.{nearest(name, header)}"
            )
    table = finite_array(path.name, rows, rows.shape)
    when = table[:, header.index("time")]
    if not when.size or (np.diff(when) <= 0).any():
        raise InvalidInputError(f"The column 'time' of {path.name} must have rows that increase.")
    columns = [np.interp(times, when, table[:, header.index(name)]) for name in names]
    return np.stack(columns, axis=1)


RATE_TOLERANCE = 0.01  # largest error of a row's time step, as a share of it


def load_demonstration(task: Task, path: Path) -> Trajectory:
    """Reads a demonstration over the task's planned horizon; later rows are left out.

    Raises:
        InvalidInputError: the file is unreadable, or names, rate or size do not fit the task.
    """
    names, rows = read_rows(path)
    wanted = _columns(task.dynamics.model)
    strange = [*sorted(set(wanted) - set(names)), *sorted(set(names) - set(wanted))]
    if strange:
        verb = "lacks the column" if strange[0] in wanted else "has the unknown column"
        raise InvalidInputError(
            f"{path} {verb} '{strange[0]}'; the {task.name} has the joints "
            f"{', '.join(task.joint_names)}, of which {', '.join(task.actuated_joint_names)} "
            "have efforts."
        )
    steps = task.planned_horizon
    if len(rows) < steps + 1:
        raise InvalidInputError(
            f"{path} has {len(rows)} rows, but the {task.name} needs {steps + 1}: "
            f"{steps} steps of {task.dynamics.time_step:g} s and a last state."
        )
    table = rows[: steps + 1, [names.index(name) for name in wanted]]
    table = finite_array(str(path), table, table.shape)
    periods = np.diff(table[:, 0])
    wrong = np.flatnonzero(np.abs(periods / task.dynamics.time_step - 1) > RATE_TOLERANCE)
    if wrong.size:
        raise InvalidInputError(
            f"{path} has {periods[wrong[0]]:.4g} s between rows {wrong[0] + 1} and "
            f"{wrong[0] + 2}, but the {task.name}'s time step is {task.dynamics.time_step:g} s: "
            "resample it."
        )
    for name, values in zip(wanted[1:], np.abs(table.T[1:]), strict=True):
        bound = CONTROL_BOUND if name in task.controls.columns else DIVERGENCE_BOUND
        if values.max() > bound:
            raise InvalidInputError(
                f"{path} has {name} {values.max():g} in row {values.argmax() + 1}, but a motion "
                f"beyond {bound:g} has diverged: check its units."
            )
    n_x = task.dims["n_x"]
    controls = task.controls.from_joints(table[:-1, 1 + n_x :])
    return Trajectory(table[:, 1 : 1 + n_x], controls)


def write_motion(path: Path, model: mujoco.MjModel, time: Array, motion: Trajectory) -> None:
    """Writes a motion that `load_demonstration` reads back bit for bit.

    Args:
        path: the file; one that is there is replaced.
        model: the robot.
        time: time of each state, shape (T+1,) [s].
        motion: x, u.

    Raises:
        OSError: it cannot be written.
    """
    commands = np.pad(controls_of(model).at_joints(motion.controls), ((0, 1), (0, 0)))
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(_columns(model))
    writer.writerows(np.column_stack([time, motion.states, commands]).tolist())
    with replacing(path) as file:
        file.write(text.getvalue().encode())


def _columns(model: mujoco.MjModel) -> list[str]:
    """Returns the names of a file's columns: time, the state's order, the controls' order."""
    return ["time", *state_names(model), *controls_of(model).columns]
