"""Writes the `metadata.yaml` of a rosbag2 bag, in version 9 of its format."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import yaml

from vgps_ros.bags.storage import FileSummary, Topic
from vgps_ros.storage.files import replacing

FILE_NAME = "metadata.yaml"


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
                "message_count": file.message_count,
            }
            for file in files
        ],
        "custom_data": None,
        "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
    }
    return yaml.safe_dump(information, sort_keys=False)


def write_metadata(folder: Path, information: str) -> None:
    """Writes `metadata.yaml` as a whole or not at all.

    Raises:
        OSError: the file cannot be written; an earlier version of it is still there.
    """
    indented = "".join(f"  {line}\n" for line in information.splitlines())
    with replacing(folder / FILE_NAME) as file:
        file.write(f"rosbag2_bagfile_information:\n{indented}".encode())
