# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The robot of a task file, with the changes and sensors that the file asks for."""

from contextlib import suppress

import msgspec
import mujoco

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.simulation.change_error import InvalidChangeError
from vgps_ros.simulation.model import compile_model
from vgps_ros.simulation.model_changes import changed_spec
from vgps_ros.simulation.self_contained import self_contained
from vgps_ros.tasks.document import Document
from vgps_ros.tasks.model_schema import Changes
from vgps_ros.tasks.task_checks import is_multiple
from vgps_ros.tasks.task_file import find_model
from vgps_ros.tasks.task_schema import TaskFile


def model_spec(task: TaskFile, document: Document) -> mujoco.MjSpec:
    """Returns the task's model with its changes and sensors; it is known to compile.

    Raises:
        InvalidInputError: the model does not compile, or a change names what it lacks.
    """
    changes, sensors = msgspec.to_builtins((task.changes, task.sensors))
    try:
        spec = changed_spec(find_model(task, document), changes, sensors)
    except InvalidChangeError as error:
        raise document.error(error.place, error.sentence) from error
    document.refuse(
        not is_multiple(task.control_period, spec.option.timestep),
        ("control_period",),
        f"it is {task.control_period:g} s, but it must be a multiple of the model's time step, "
        f"{spec.option.timestep:g} s.",
    )
    return spec


def model_text(task: TaskFile, document: Document) -> str:
    """Returns the model as one MJCF text that needs no other file.

    It is the robot's own text where that can stand as it is, since to write it anew rounds the
    orientation of its inertias in the last bits.

    Raises:
        InvalidInputError: as `model_spec` does.
    """
    spec = model_spec(task, document)
    if task.changes == Changes() and not task.sensors:
        with suppress(InvalidInputError, UnicodeDecodeError):
            text = find_model(task, document).read_text()
            compile_model(text)
            return text
    with document.at(("model",)):
        return self_contained(spec)
