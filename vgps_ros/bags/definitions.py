# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds the definitions of message types, which a bag holds so that any reader can decode it.

The definitions of standard types come with rosbags. Those of other types, such as the project's
own, are read from the `.msg` files of installed interface packages, through the ament index.
"""

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vgps_ros.core.errors import InvalidInputError


class MessageDefinitions:
    """Finds the concatenated definition of a message type."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)

    def find(self, name: str) -> str:
        """Returns the definition of a type such as `sensor_msgs/msg/JointState`.

        Raises:
            InvalidInputError: the type's package is not installed, or has no such message.
        """
        self._register(name)
        return self._store.generate_msgdef(name, ros_version=2)[0]

    def _register(self, name: str) -> None:
        """Adds a type and the types of its fields to the store."""
        if name in self._store.fielddefs:
            return
        types = get_types_from_msg(self._path(name).read_text(), name)
        for fields in types.values():
            for _, (_, description) in fields[1]:
                for inner in _type_names(description):
                    self._register(inner)
        self._store.register(types)

    def _path(self, name: str) -> Path:
        package, _, message = name.partition("/msg/")
        try:
            path = Path(get_package_share_directory(package), "msg", f"{message}.msg")
        except (PackageNotFoundError, ValueError):
            path = Path()
        if not path.is_file():
            raise InvalidInputError(
                f"The definition of {name} is not installed: build its package, or source it."
            )
        return path


def _type_names(description: object) -> list[str]:
    """Returns the names of all message types in the description of a field, at any depth."""
    if isinstance(description, str):
        return [description] if "/msg/" in description else []
    if isinstance(description, tuple):
        return [name for part in description for name in _type_names(part)]
    return []
