# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The files beside the messages of a rosbag2 bag: `metadata.yaml`, and `SHA256SUMS`.

`metadata.yaml` is written in version 9 of its format. `SHA256SUMS` has the digest of each file, so
that `sha256sum -c SHA256SUMS` finds what was damaged or altered later. Whoever alters a bag can
write it anew, unless it is signed:

    ssh-keygen -Y sign -n vgps-bag -f KEY SHA256SUMS
    ssh-keygen -Y verify -n vgps-bag -f ALLOWED_SIGNERS -I NAME -s SHA256SUMS.sig < SHA256SUMS
"""

import hashlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from vgps_ros.bags.mcap_file import FileSummary, Topic
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.files import read_yaml, replacing

FILE_NAME, DIGESTS = "metadata.yaml", "SHA256SUMS"
_FOREIGN_STORAGE, _FOREIGN_MODES = ("sqlite3",), ("file", "message", "FILE", "MESSAGE")
_LARGEST = 2**24  # of a description that is read [bytes]


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


def read_metadata(folder: Path) -> tuple[list[str], dict[str, str]] | None:
    """Returns the names of a bag's files, without folders; None if not all can be read.

    And the type hash of each topic, which some writers put nowhere else.

    Raises:
        InvalidInputError: `metadata.yaml` is of a bag that is not read here.
    """
    path = folder / FILE_NAME
    if not path.is_file() or path.stat().st_size > _LARGEST:
        return None
    try:
        content: Any = read_yaml(path.read_text(errors="replace"), f"'{path}'")
        information = content["rosbag2_bagfile_information"]
        storage, mode = information["storage_identifier"], information["compression_mode"]
        names = [Path(str(name)).name for name in information["relative_file_paths"]]
        topics = [each["topic_metadata"] for each in information["topics_with_message_count"]]
        hashes = {str(t["name"]): str(t.get("type_description_hash", "")).strip() for t in topics}
    except (InvalidInputError, AttributeError, KeyError, TypeError):
        return None
    if storage in _FOREIGN_STORAGE or mode in _FOREIGN_MODES:
        raise InvalidInputError(
            f"'{folder}' is not a bag that can be read: its storage is {storage} with the "
            f"compression mode {mode!r}, and only mcap with compressed chunks is read."
        )
    return names, hashes


def write_metadata(folder: Path, information: str) -> None:
    """Writes `metadata.yaml` as a whole or not at all.

    Raises:
        OSError: the file cannot be written; an earlier version of it is still there.
    """
    indented = "".join(f"  {line}\n" for line in information.splitlines())
    with replacing(folder / FILE_NAME) as file:
        file.write(f"rosbag2_bagfile_information:\n{indented}".encode())


def write_digests(folder: Path, digests: Mapping[str, str]) -> None:
    """Writes `SHA256SUMS`, as `sha256sum` does, with the SHA-256 of each `.mcap` file by its name.

    Raises:
        OSError: the file cannot be written.
    """
    known = {**digests, FILE_NAME: file_digest(folder / FILE_NAME)}
    with replacing(folder / DIGESTS) as file:
        file.write("".join(f"{digest}  {name}\n" for name, digest in known.items()).encode())


def file_digest(path: Path) -> str:
    """Returns the SHA-256 of a file.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_digests(folder: Path) -> list[str] | None:
    """Returns a sentence on each file that is not as `SHA256SUMS` says; None if there is no such.

    Raises:
        OSError: a file cannot be read.
    """
    path = folder / DIGESTS
    if not path.is_file() or path.stat().st_size > _LARGEST:
        return None
    lines = path.read_text(errors="replace").splitlines()
    digests = {
        found[2]: found[1]
        for line in lines
        if (found := re.match(r"([0-9a-f]{64})  ([^/]+)$", line))
    }
    wrong = [
        f"{name} is not as its recorder wrote it, by {DIGESTS}"
        for name, digest in digests.items()
        if not (folder / name).is_file() or file_digest(folder / name) != digest
    ]
    present = {file.name for file in folder.glob("*.mcap")}
    return wrong + [f"{name} is not in {DIGESTS}" for name in sorted(present - set(digests))]
