# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Repairs bags whose recorder was killed, or that are damaged.

After a kill a bag has no `metadata.yaml`. Its last file has no index, and may end within a record.
"""

import os
from dataclasses import replace
from pathlib import Path

from vgps_ros.bags.metadata import (
    FILE_NAME,
    bag_information,
    read_metadata,
    require_replaceable,
    type_hashes,
    write_metadata,
)
from vgps_ros.bags.storage import StorageScan, Topic, is_being_written
from vgps_ros.bags.storage_writer import StorageWriter
from vgps_ros.core.errors import InvalidInputError


def storage_files(path: Path) -> list[Path]:
    """Returns the `.mcap` files in a bag's folder, in the order in which they were written.

    Raises:
        InvalidInputError: the folder has no such file.
    """
    found = [file for file in path.glob("*.mcap") if file.is_file()]  # no pipe, no device
    files = sorted(found, key=lambda file: (len(file.name), file.name))
    if not files:
        raise InvalidInputError(
            f"'{path}' is not a bag: it must be a folder with .mcap files, and there is none."
        )
    return files


def missing_parts(path: Path) -> str:
    """Returns a sentence on what a bag lacks and what can be read of it; "" if it is complete.

    Raises:
        InvalidInputError: the folder has no `.mcap` file, or its description cannot be read.
    """
    return missing_of(path, [StorageScan(file) for file in storage_files(path)])


def missing_of(path: Path, files: list[StorageScan]) -> str:
    """Returns the same sentence of files that were read already."""
    lacks = [f"the index of {file.path.name}" for file in files if not file.is_complete]
    named = read_metadata(path)
    if named is None:
        lacks.insert(0, f"a whole {FILE_NAME}" if (path / FILE_NAME).exists() else FILE_NAME)
    elif absent := set(named) - {file.path.name for file in files}:
        lacks.insert(0, f"the file {', '.join(sorted(absent))}")
    if not lacks:
        return ""
    if any(is_being_written(file.path) for file in files):
        return f"The bag '{path}' is still being recorded; end its recorder first."
    summaries = [file.summary for file in files]
    count = sum(summary.message_count for summary in summaries)
    last = max(summary.end for summary in summaries)
    first = min((summary.start for summary in summaries if summary.start), default=last)
    if not count:
        return (
            f"'{path}' lacks {' and '.join(lacks)}, and no message in it can be read: it is no "
            "bag, or all of it is lost; name another one."
        )
    return (
        f"The bag '{path}' was not closed: it lacks {' and '.join(lacks)}. {count} messages over "
        f"{(last - first) * 1e-9:.3f} s can be read, and all others are lost; "
        f"`vgps bag reindex {path}` repairs it."
    )


def reindex(path: Path) -> list[Path]:
    """Rebuilds `metadata.yaml`, and each file that has no index or is damaged.

    The original of a rebuilt file is kept, with `.unfinished` at the end of its name.

    Args:
        path: folder of the bag.

    Returns:
        The files that were rebuilt.

    Raises:
        InvalidInputError: the folder has no `.mcap` file, nothing can be read of any, or one is
            still being written.
        OSError: the disk is full; nothing is lost, and the call can be repeated.
    """
    files = storage_files(path)
    for file in files:
        if is_being_written(file):
            raise InvalidInputError(f"'{file}' is still being recorded; end its recorder first.")
    require_replaceable(path)
    contents = [StorageScan(file) for file in files]
    known = [content for content in contents if content.topics]
    if not known:
        raise InvalidInputError(f"'{path}' cannot be rebuilt: not one of its messages can be read.")
    topics: dict[str, Topic] = {}
    hashes = type_hashes(path)
    for topic in (topic for content in known for topic in content.topics.values()):
        type_hash = topic.type_hash or hashes.get(topic.name, "")
        topics.setdefault(topic.name, replace(topic, type_hash=type_hash))
    information = bag_information(topics.values(), [content.summary for content in known])
    rebuilt = [c for c in known if c.damages or not c.is_complete]
    for content in rebuilt:
        _rebuild(content, information)
    for content in contents:
        if not content.topics:  # the recorder was killed before the first message was on the disk
            os.replace(content.path, _unfinished(content.path))
    write_metadata(path, information)
    return [content.path for content in rebuilt]


def _rebuild(content: StorageScan, information: str) -> None:
    file = content.path
    partial = file.with_name(f"{file.name}.partial")
    try:
        with partial.open("wb") as output:
            writer = StorageWriter(output, content.content.compression)
            for number, channel in content.content.channels.items():
                schema = content.content.schemas.get(channel.schema_id)
                writer.add_channel(number, channel, schema)
            for attachment in content.content.attachments:
                writer.add_attachment(attachment)
            for place in content.content.places:
                for _, message in content.messages(place):
                    writer.write(*message)
            writer.close(information)
    except OSError:
        partial.unlink(missing_ok=True)  # half a file would only fill the disk
        raise
    os.replace(file, _unfinished(file))
    os.replace(partial, file)


def _unfinished(file: Path) -> Path:
    return file.with_name(f"{file.name}.unfinished")
