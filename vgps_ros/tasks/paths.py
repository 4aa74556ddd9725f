# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A path of states from which a first solve starts, though no robot could follow it."""

from pathlib import Path as FilePath

import mujoco
import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.simulation.model import state_names
from vgps_ros.tasks.start import keyframe
from vgps_ros.tasks.table import read_rows, read_table
from vgps_ros.tasks.task import Task
from vgps_ros.tasks.task_schema import Path
from vgps_ros.tasks.yaml_document import Document

_PLACES = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_FREE)  # joints with lengths


def path_states(task: Task, begin: Path, document: Document) -> Array:
    """Returns the states of a path over the planned horizon, shape (T+1, n_x).

    Positions are those of the path, velocities are their differences over time, and activations
    are zero.

    Raises:
        InvalidInputError: the path names what the model or its file lacks.
    """
    if begin.file is None:
        states = _between_keyframes(task, begin, document)
    else:
        path = document.file(("begin", "file"), begin.file)
        with document.at(("begin", "file")):
            states = _recorded(task, path, begin.scale)
    n_q, n_v = task.dynamics.model.nq, task.dynamics.model.nv
    space, period = task.dynamics.space, task.dynamics.time_step
    moves = space.subtract(states[1:], states[:-1])[:, :n_v]
    states[:, n_q : n_q + n_v] = np.concatenate([moves, moves[-1:]]) / period
    return states


def _between_keyframes(task: Task, begin: Path, document: Document) -> Array:
    """Returns states on lines from the start through the keyframes, at even times."""
    model, space = task.dynamics.model, task.dynamics.space
    knots = [_at_rest(task)]
    for i, name in enumerate(begin.through):
        knot = knots[0].copy()
        knot[: model.nq] = model.key_qpos[keyframe(model, name, document, ("begin", "through", i))]
        knots.append(knot)
    when = np.linspace(0.0, len(knots) - 1.0, task.planned_horizon + 1)
    before = np.minimum(when.astype(int), max(len(knots) - 2, 0))
    after = np.minimum(before + 1, len(knots) - 1)
    origins, ends = np.stack(knots)[before], np.stack(knots)[after]
    return space.add(origins, (when - before)[:, None] * space.subtract(ends, origins))


def _recorded(task: Task, path: FilePath, scale: float) -> Array:
    """Returns states with the positions of a file, and the start's where it has none."""
    model = task.dynamics.model
    positions = state_names(model)[: model.nq]
    header, _ = read_rows(path)
    names = [name for name in positions if name in header]
    if not names:
        raise InvalidInputError(
            f"{path.name} has none of the columns {', '.join(positions)}; name them time and "
            "JOINT/position."
        )
    times = task.dynamics.time_step * np.arange(task.planned_horizon + 1)
    states = np.tile(_at_rest(task), (len(times), 1))
    columns = [positions.index(name) for name in names]
    lengths = {
        model.jnt_qposadr[joint] + i
        for joint in np.flatnonzero(np.isin(model.jnt_type, _PLACES))
        for i in range(3 if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE else 1)
    }
    factors = np.where(np.isin(columns, list(lengths)), scale, 1.0)
    states[:, columns] = factors * read_table(path, names, times)
    for state in states:
        mujoco.mj_normalizeQuat(model, state[: model.nq])
    return states


def _at_rest(task: Task) -> Array:
    """Returns the start without its velocities and activations, shape (n_x,)."""
    state = task.initial_state.copy()
    state[task.dynamics.model.nq :] = 0.0
    return state
