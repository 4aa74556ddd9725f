# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes the `metadata.yaml` of a rosbag2 bag, in version 9 of its format."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from vgps_ros.bags.storage import FileSummary, Topic
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.files import replacing
from vgps_ros.storage.plain_yaml import read_yaml

FILE_NAME = "metadata.yaml"
_FOREIGN_STORAGE, _FOREIGN_MODES = ("sqlite3",), ("file", "message", "FILE", "MESSAGE")
_LARGEST = 2**24  # of a description that is read [bytes]
# What `metadata.yaml` tells of the files and topics, by its keys.
_TOLD: dict[str, Callable[[Any], Any]] = {
    "starting_time": lambda told: told["starting_time"]["nanoseconds_since_epoch"],
    "duration": lambda told: told["duration"]["nanoseconds"],
    "message_count": lambda told: told["message_count"],
    "topics_with_message_count": lambda told: {
        (t["topic_metadata"]["name"], t["topic_metadata"]["type_description_hash"]): t[
            "message_count"
        ]
        for t in told["topics_with_message_count"]
    },
    "files": lambda told: {file["path"]: file["message_count"] for file in told["files"]},
}


def bag_information(topics: Iterable[Topic], files: Sequence[FileSummary]) -> str:
    """Returns the description of a bag as YAML. Each file of the bag holds it, too."""
    written = [file for file in files if file.message_count]
    start = min((file.start for file in written), default=0)
    end = max((file.end for file in written), default=0)
    information = {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(file.message_count for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.kind,
                    "serialization_format": topic.serialization,
                    "offered_qos_profiles": list(topic.qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": sum(file.counts.get(topic.name, 0) for file in files),
            }
            for topic in topics
        ],
        # Rosbag2 would compress whole files or messages; ours are compressed by MCAP, in chunks.
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start},
                "duration": {"nanoseconds": file.end - file.start},
                "message_count": file.message_count,
            }
            for file in files
        ],
        "custom_data": None,
        "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
    }
    return yaml.safe_dump(information, sort_keys=False)


def type_hashes(folder: Path) -> dict[str, str]:
    """Returns the type hash of each topic that `metadata.yaml` tells, if it can be read.

    Some writers put the hashes nowhere else.
    """
    try:
        entries = _information(folder)["topics_with_message_count"]
        topics = [entry["topic_metadata"] for entry in entries]
        return {str(t["name"]): str(t["type_description_hash"]).strip() for t in topics}
    except (InvalidInputError, KeyError, TypeError):
        return {}


def contradictions(
    folder: Path, files: Iterable[FileSummary], type_hashes: Mapping[str, str]
) -> list[str]:
    """Returns what `metadata.yaml` tells of a bag's files and topics that is not so, by its keys.

    Args:
        folder: folder of the bag.
        files: what is in its files.
        type_hashes: the type hash of each topic in them.
    """
    topics = [Topic(name, "", given, (), "") for name, given in type_hashes.items()]
    truth = yaml.safe_load(bag_information(topics, list(files)))
    try:
        told = _information(folder)
        return [key for key, read in _TOLD.items() if read(told) != read(truth)]
    except (AttributeError, InvalidInputError, KeyError, TypeError):
        return list(_TOLD)


def read_metadata(folder: Path) -> list[str] | None:
    """Returns the names of the files of a bag, without folders; None if nothing can be read.

    Raises:
        InvalidInputError: `metadata.yaml` is no file, or of a bag that ours do not read.
    """
    require_replaceable(folder)
    try:
        information = _information(folder)
        storage, mode = information["storage_identifier"], information["compression_mode"]
        names = [Path(str(name)).name for name in information["relative_file_paths"]]
    except (InvalidInputError, KeyError, TypeError):
        return None
    if storage in _FOREIGN_STORAGE or mode in _FOREIGN_MODES:
        raise InvalidInputError(
            f"'{folder}' is not a bag that can be read: its storage is {storage} with the "
            f"compression mode {mode!r}, and only mcap with compressed chunks is read."
        )
    return names


def _information(folder: Path) -> Any:
    """Returns the description in `metadata.yaml`, which may hold anything.

    Raises:
        InvalidInputError: there is no such file, it is too large, or it is not YAML.
        KeyError, TypeError: it holds no description of a bag.
    """
    path = folder / FILE_NAME
    if not path.is_file() or path.stat().st_size > _LARGEST:
        raise InvalidInputError(f"'{path}' is not a file of at most {_LARGEST} bytes.")
    content: Any = read_yaml(path.read_text(errors="replace"), f"'{path}'")
    return content["rosbag2_bagfile_information"]


def require_replaceable(folder: Path) -> None:
    """Checks that `metadata.yaml`, if there is one, is a file, so that another can take its place.

    Raises:
        InvalidInputError: it is something else.
    """
    path = folder / FILE_NAME
    if path.exists() and not path.is_file():
        raise InvalidInputError(
            f"'{path}' is a folder or a device, but it must be a file: move it away, and "
            f"`vgps bag reindex {folder}` writes it anew."
        )


def write_metadata(folder: Path, information: str) -> None:
    """Writes `metadata.yaml` as a whole or not at all.

    Raises:
        OSError: the file cannot be written; an earlier version of it is still there.
    """
    indented = "".join(f"  {line}\n" for line in information.splitlines())
    with replacing(folder / FILE_NAME) as file:
        file.write(f"rosbag2_bagfile_information:\n{indented}".encode())
