# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A digest of all that a task file resolves to, which tells a changed task from the one before.

It walks through the whole record, so that an entry of the file that is new one day belongs to it
too. Of code, as a task in Python has it, the names of functions and what they hold belong to it.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from typing import Any

import numpy as np

from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks.task import Task

# What a training's identity has by name: the task, and the settings of which these are defaults.
_NAMED = ("name", "optimizer", "search")


def task_digest(task: Task) -> str:
    """Returns twelve hexadecimal digits that another robot, cost, start or fall changes."""
    content = {f.name: getattr(task, f.name) for f in fields(task) if f.name not in _NAMED}
    return hashlib.sha256(repr(_plain(content)).encode()).hexdigest()[:12]


def _plain(value: Any, *around: int) -> Any:
    """Returns a value as tuples whose text is the same in each process.

    Args:
        value: the value.
        around: identities of the values that hold it, since a function may hold itself.
    """
    if id(value) in around:
        return "itself"
    parts: Any
    if value is None or isinstance(value, bool | int | float | str | bytes):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, Dynamics):  # its model is that of the task's MJCF
        parts = value.substeps, value.eps
    elif isinstance(value, Readings):
        parts = value.names
    elif is_dataclass(value) and not isinstance(value, type):
        parts = [(f.name, getattr(value, f.name)) for f in fields(value)]
    elif isinstance(value, Mapping):
        parts = sorted(value.items(), key=repr)
    elif isinstance(value, tuple | list):
        parts = value
    elif isinstance(value, partial):
        parts = value.func, value.args, value.keywords
    else:
        cells = getattr(value, "__closure__", None) or ()
        parts = [getattr(value, "__qualname__", ""), *(cell.cell_contents for cell in cells)]
    inner = (*around, id(value))
    return type(value).__name__, *(_plain(part, *inner) for part in parts)
