"""Control problems, by name. Their names and settings are there before MuJoCo is loaded."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vgps_ros.core.checks import one_of
from vgps_ros.tasks.settings import TASKS

if TYPE_CHECKING:
    from vgps_ros.tasks.task import Task


def make_task(name: str, demonstration: str = "") -> "Task":
    """Builds a task.

    Args:
        name: its name in the registry.
        demonstration: file of a recorded demonstration to use; empty for the task's own start.

    Raises:
        InvalidInputError: the name is unknown, and the message has the valid ones; or the
            demonstration does not fit the task.
    """
    settings = TASKS[one_of("task", name, TASKS)]
    make = getattr(import_module(f"vgps_ros.tasks.{name}"), name)
    task: Task = replace(make(), optimizer=settings.optimizer, search=settings.search)
    if demonstration:
        from vgps_ros.tasks.motion_file import with_demonstration

        task = with_demonstration(task, Path(demonstration))
    return task


def __getattr__(name: str) -> Any:
    """Loads `Task` when it is first asked for."""
    if name == "Task":
        return import_module("vgps_ros.tasks.task").Task
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


__all__ = ["TASKS", "Task", "make_task"]
