"""Message types by name."""

from importlib import import_module

from vgps_ros.core.errors import InvalidInputError


def message_type(kind: str) -> type:
    """Returns the class of a type such as `sensor_msgs/msg/JointState`.

    Raises:
        InvalidInputError: its package is not installed, or has no such message.
    """
    package, _, name = kind.partition("/msg/")
    try:
        found: type = getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InvalidInputError(
            f"the type {kind} is not installed; build or source its package."
        ) from error
    return found
