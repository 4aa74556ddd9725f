# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Message types by name."""

from importlib import import_module

from ament_index_python import get_resource

from vgps_ros.core.errors import InvalidInputError


def message_type(kind: str) -> type:
    """Returns the class of a type such as `sensor_msgs/msg/JointState`.

    The name may come from a bag or from another host, so that only what an installed interface
    package lists is imported.

    Raises:
        InvalidInputError: its package is not installed, or has no such message.
    """
    package, _, name = kind.partition("/msg/")
    try:
        listed = get_resource("rosidl_interfaces", package)[0].split() if package else []
        if f"msg/{name}.idl" not in listed:  # one is made of each .msg file
            raise LookupError(kind)
        found: type = getattr(import_module(f"{package}.msg"), name)
    except (LookupError, ImportError, AttributeError, ValueError, OSError) as error:
        raise InvalidInputError(
            f"the type {kind} is not installed; build or source its package."
        ) from error
    return found
