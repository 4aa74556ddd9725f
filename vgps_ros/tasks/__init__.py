"""Control problems, by name."""

from collections.abc import Callable

from vgps_ros.core.checks import one_of
from vgps_ros.tasks.swimmer import swimmer
from vgps_ros.tasks.task import Task
from vgps_ros.tasks.walker import walker

TASKS: dict[str, Callable[[], Task]] = {"swimmer": swimmer, "walker": walker}


def make_task(name: str) -> Task:
    """Builds a task.

    Raises:
        InvalidInputError: the name is unknown; the message has the valid ones.
    """
    return TASKS[one_of("task", name, TASKS)]()


__all__ = ["TASKS", "Task", "make_task"]
