# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The files beside the messages of a rosbag2 bag: `metadata.yaml`, and `SHA256SUMS`.

`metadata.yaml` is written in version 9 of its format. `SHA256SUMS` has the digest of each file, so
that `sha256sum -c SHA256SUMS` finds what was damaged or altered later. Whoever alters a bag can
write it anew, unless it is signed:

    ssh-keygen -Y sign -n vgps-bag -f KEY SHA256SUMS
    ssh-keygen -Y verify -n vgps-bag -f ALLOWED_SIGNERS -I NAME -s SHA256SUMS.sig < SHA256SUMS
"""

import fcntl
import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from vgps_ros.storage.files import open_plain, read_file, replacing

FILE_NAME, DIGESTS = "metadata.yaml", "SHA256SUMS"
_LARGEST = 2**24  # of a list of digests that is read [bytes]


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: its full name.
        kind: its type, such as `sensor_msgs/msg/JointState`.
        type_hash: RIHS01 hash of the type, as the graph has it.
        qos: profiles that its publishers offer, as `metadata.yaml` has them.
        definition: the type's definition, with those of its fields.
    """

    name: str
    kind: str
    type_hash: str
    qos: Sequence[dict[str, Any]]
    definition: str = ""


@dataclass
class FileSummary:
    """Counts the messages of one file of a bag.

    Attributes:
        name: name of the file in the folder of the bag.
        start: time at which its first message was received [ns]; 0 if there is none.
        end: time at which its last message was received [ns]; 0 if there is none.
        counts: number of messages of each topic.
    """

    name: str
    start: int = 0
    end: int = 0
    counts: Counter[Any] = field(default_factory=Counter)

    def add(self, topic: Any, stamp: int) -> None:
        """Counts a message by its topic and its time of receipt [ns]."""
        self.counts[topic] += 1
        self.end = max(self.end, stamp)
        self.start = min(self.start or stamp, stamp)


def storage_files(path: Path) -> list[Path]:
    """Returns the `.mcap` files in a bag's folder, in the order in which they were written."""
    found = [file for file in path.glob("*.mcap") if file.is_file()]  # no pipe, no device
    return sorted(found, key=lambda file: (len(file.name), file.name))


def is_being_written(path: Path) -> bool:
    """Returns whether a `BagWriter` of some process still writes the file."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def bag_information(topics: Iterable[Topic], files: Sequence[FileSummary]) -> dict[str, Any]:
    """Returns the description of a bag, or of one of its files."""
    written = [file for file in files if file.counts.total()]
    start = min((file.start for file in written), default=0)
    end = max((file.end for file in written), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(file.counts.total() for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.kind,
                    "serialization_format": "cdr",
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
                "message_count": file.counts.total(),
            }
            for file in files
        ],
        "custom_data": None,
        "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
    }


def write_metadata(folder: Path, topics: Iterable[Topic], files: Sequence[FileSummary]) -> None:
    """Writes `metadata.yaml` as a whole or not at all.

    Raises:
        OSError: the file cannot be written; an earlier version of it is still there.
    """
    content = {"rosbag2_bagfile_information": bag_information(topics, files)}
    with replacing(folder / FILE_NAME) as file:
        file.write(yaml.safe_dump(content, sort_keys=False).encode())


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
    with open_plain(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_digests(folder: Path) -> list[str] | None:
    """Returns a sentence on each file that is not as `SHA256SUMS` says; None if there is no such.

    Raises:
        OSError: a file cannot be read.
    """
    try:
        lines = read_file(folder / DIGESTS, _LARGEST).decode(errors="replace").splitlines()
    except FileNotFoundError:
        return None
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
