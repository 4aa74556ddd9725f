# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The state from which a task starts."""

import mujoco
import numpy as np

from vgps_ros.core.checks import quoted
from vgps_ros.core.patterns import known
from vgps_ros.core.records import Array
from vgps_ros.tasks.task_schema import Start
from vgps_ros.tasks.yaml_document import Document, Place


def start_state(start: Start, model: mujoco.MjModel, document: Document) -> Array:
    """Returns the mean of x_1, shape (n_x,).

    Raises:
        InvalidInputError: the start names what the model lacks.
    """
    data = mujoco.MjData(model)
    if start.keyframe is not None:
        number = keyframe(model, start.keyframe, document, ("start", "keyframe"))
        mujoco.mj_resetDataKeyframe(model, data, number)
    for key, values, addresses in (
        ("positions", data.qpos, model.jnt_qposadr),
        ("velocities", data.qvel, model.jnt_dofadr),
    ):
        for name, given in getattr(start, key).items():
            _put(model, name, given, values, addresses, document, ("start", key, name))
    mujoco.mj_normalizeQuat(model, data.qpos)
    return np.concatenate([data.qpos, data.qvel, data.act])


def keyframe(model: mujoco.MjModel, wanted: str | int, document: Document, place: Place) -> int:
    """Returns the number of a keyframe.

    Raises:
        InvalidInputError: the model has none of this name or number.
    """
    names = [model.key(i).name or str(i) for i in range(model.nkey)]
    with document.at(place):
        if isinstance(wanted, int) and wanted < model.nkey:
            return wanted
        return names.index(known("keyframe", str(wanted), names))


def _put(model, name, given, values, addresses, document, place):  # type: ignore[no-untyped-def]
    """Writes a joint's values."""
    names = [model.joint(i).name for i in range(model.njnt)]
    with document.at(place):
        i = names.index(known("joint", name, names))
    ends = [*addresses[1:], len(values)]
    numbers, size = np.atleast_1d(np.array(given, dtype=float)), ends[i] - addresses[i]
    if numbers.size != size:
        raise document.error(
            place, f"{quoted(name)} has {size} numbers, but {numbers.size} are given."
        )
    values[addresses[i] : ends[i]] = numbers
