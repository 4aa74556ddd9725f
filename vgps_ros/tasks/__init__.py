"""Control problems, by name."""

from collections.abc import Callable
from pathlib import Path

from vgps_ros.core.checks import one_of
from vgps_ros.tasks.motion_file import with_demonstration
from vgps_ros.tasks.rotor import rotor
from vgps_ros.tasks.swimmer import swimmer
from vgps_ros.tasks.task import Task
from vgps_ros.tasks.walker import walker

TASKS: dict[str, Callable[[], Task]] = {
    "rotor": rotor,
    "swimmer": swimmer,
    "walker": walker,
}


def make_task(name: str, demonstration: str = "") -> Task:
    """Builds a task.

    Args:
        name: its name in the registry.
        demonstration: file of a recorded demonstration to use; empty for the task's own start.

    Raises:
        InvalidInputError: the name is unknown, and the message has the valid ones; or the
            demonstration does not fit the task.
    """
    task = TASKS[one_of("task", name, TASKS)]()
    return with_demonstration(task, Path(demonstration)) if demonstration else task


__all__ = ["TASKS", "Task", "make_task"]
