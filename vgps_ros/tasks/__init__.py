# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Control problems as data. Their names and settings are there before MuJoCo is loaded."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks.registry import BUILT_IN, runs_code, task_file_of, task_function_of

if TYPE_CHECKING:
    from vgps_ros.tasks.task import Task


def make_task(reference: str, demonstration: str = "") -> "Task":
    """Builds a task.

    Args:
        reference: a name, a task file or its folder, or FILE.py:FUNCTION, whose code is run.
        demonstration: table of a recorded motion, or a policy whose motion it is; empty for the
            task's own start.

    Raises:
        InvalidInputError: there is no such task, and the message has the names; the task is wrong;
            the demonstration does not fit it; or the robot has fallen where it starts.
    """
    from vgps_ros.tasks.task import Task

    path = task_file_of(reference)
    if function := task_function_of(reference):
        task = function()
        if not isinstance(task, Task):
            raise InvalidInputError(
                f"{quote(reference)} returns {type(task).__name__}, but it must return a "
                "vgps_ros.tasks.Task."
            )
    else:
        from vgps_ros.tasks.builder import load_task

        assert path is not None
        task = load_task(path, reference if reference in BUILT_IN else str(path.resolve()))
    if demonstration:
        from vgps_ros.tasks.first_motion import with_demonstration

        task = with_demonstration(task, Path(demonstration))
    for name, conditions in (("fallen", task.fallen), ("limits", task.limits)):
        if broken := conditions.broken(task.initial_state):
            raise InvalidInputError(
                f"{name} of the task {quote(reference)} excludes its start: {broken} Change the "
                "start or the limit."
            )
    return task


def recorded_task(reference: str) -> "Task":
    """Builds the task that a file or a bag names, which may come from anybody.

    Raises:
        InvalidInputError: as `make_task` does, or the task is Python code in a file.
    """
    if runs_code(reference):
        raise InvalidInputError(
            f"The task {quote(reference)} is Python code, which is not run because a file names "
            "it; offer it as an entry point of the group vgps_ros.tasks."
        )
    return make_task(reference)


def __getattr__(name: str) -> Any:
    """Loads `Task` when it is first asked for."""
    if name == "Task":
        return import_module("vgps_ros.tasks.task").Task
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


__all__ = ["BUILT_IN", "Task", "make_task", "recorded_task"]
