"""The robot of a task file, with the changes and sensors that the file asks for."""

import msgspec
import mujoco

from vgps_ros.simulation.change_error import InvalidChangeError
from vgps_ros.simulation.model_changes import changed_spec
from vgps_ros.tasks.document import Document
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
