"""Repairs bags whose recorder was killed.

Such a bag has no `metadata.yaml`. Its last file has no index, and may end in the middle of a
record.
"""

import os
from pathlib import Path

from mcap.records import Attachment

from vgps_ros.bags.metadata import FILE_NAME, bag_information, write_metadata
from vgps_ros.bags.storage import StorageScan, is_being_written
from vgps_ros.bags.storage_writer import StorageWriter
from vgps_ros.core.errors import InvalidInputError


def storage_files(path: Path) -> list[Path]:
    """Returns the `.mcap` files in a bag's folder, in the order in which they were written.

    Raises:
        InvalidInputError: the folder has no such file.
    """
    files = sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
    if not files:
        raise InvalidInputError(
            f"'{path}' is not a bag: it must be a folder with .mcap files, and there is none."
        )
    return files


def missing_parts(path: Path) -> str:
    """Returns a sentence on what a bag lacks and what can be read of it; "" if it is complete.

    Raises:
        InvalidInputError: the folder has no `.mcap` file.
    """
    contents = {file: StorageScan(file) for file in storage_files(path)}
    lacks = [f"the index of {file.name}" for file, c in contents.items() if not c.is_complete]
    if not (path / FILE_NAME).is_file():
        lacks.insert(0, FILE_NAME)
    if not lacks:
        return ""
    if any(is_being_written(file) for file in contents):
        return f"The bag '{path}' is still being recorded; end its recorder first."
    summaries = [content.summary for content in contents.values()]
    count = sum(summary.message_count for summary in summaries)
    last = max(summary.end for summary in summaries)
    first = min((summary.start for summary in summaries if summary.start), default=last)
    return (
        f"The bag '{path}' was not closed: it lacks {' and '.join(lacks)}. {count} messages over "
        f"{(last - first) * 1e-9:.3f} s can be read, and all later ones are lost; "
        f"`vgps bag reindex {path}` repairs it."
    )


def reindex(path: Path) -> list[Path]:
    """Rebuilds `metadata.yaml`, and each file that has no index.

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
    contents = {file: StorageScan(file) for file in files}
    known = [content for content in contents.values() if content.topics]
    if not known:
        raise InvalidInputError(f"'{path}' cannot be rebuilt: not one of its messages can be read.")
    topics = {name: topic for content in known for name, topic in content.topics.items()}
    information = bag_information(topics.values(), [content.summary for content in known])
    rebuilt = [file for file, c in contents.items() if c.topics and not c.is_complete]
    for file in rebuilt:
        _rebuild(file, contents[file], information)
    for file, content in contents.items():
        if not content.topics:  # the recorder was killed before the first message was on the disk
            os.replace(file, _unfinished(file))
    write_metadata(path, information)
    return rebuilt


def _rebuild(file: Path, content: StorageScan, information: str) -> None:
    partial = file.with_name(f"{file.name}.partial")
    try:
        with partial.open("wb") as output:
            writer = StorageWriter(output, content.compression)
            for topic in content.topics.values():
                writer.add_topic(topic)
            for record in content.records():
                if isinstance(record, Attachment):
                    writer.attach(record.name, record.data, record.log_time)
                else:
                    topic, message = record
                    writer.write(topic.name, message.log_time, message.data)
            writer.close(information)
    except OSError:
        partial.unlink(missing_ok=True)  # half a file would only fill the disk
        raise
    os.replace(file, _unfinished(file))
    os.replace(partial, file)


def _unfinished(file: Path) -> Path:
    return file.with_name(f"{file.name}.unfinished")
