# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Rebuilds bags whose recorder was killed, and those with damaged files.

A damaged chunk costs only itself. Where the length of a record is damaged, the rest of its file is
lost.
"""

import os
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.well_known import Profile
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from vgps_ros.bags.metadata import (
    FILE_NAME,
    FileSummary,
    Topic,
    file_digest,
    is_being_written,
    storage_files,
    write_digests,
    write_metadata,
)
from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.writer import CHUNK_SIZE, COMPRESSIONS
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.files import replacing


def repair(path: Path) -> dict[Path, list[str]]:
    """Rebuilds `metadata.yaml`, and each file that has no index or is damaged.

    The original of a rebuilt file is kept, with `.unfinished` at the end of its name.

    Returns:
        The files that were rebuilt, each with a sentence on each fault that it had; nothing if the
        bag is whole.

    Raises:
        InvalidInputError: the folder has no `.mcap` file, nothing can be read of any, or one is
            still being written.
        OSError: the disk is full; nothing is lost, and the call can be repeated.
    """
    files = storage_files(path)
    if not files or any(map(is_being_written, files)):
        with BagReader(path):  # which says what is wrong
            return {}
    contents = [_Content(file) for file in files]
    kept = [content for content in contents if content.channels or not content.faults]
    if not kept:
        raise InvalidInputError(f"'{path}' cannot be rebuilt: not one of its messages can be read.")
    faulty = [content for content in contents if content.faults]
    if not faulty:
        with suppress(InvalidInputError), BagReader(path):
            return {}
    topics = {topic.name: topic for content in kept for topic in content.topics()}
    for content in faulty:
        content.rebuild()
    write_metadata(path, topics.values(), [content.summary for content in kept])
    write_digests(path, {content.path.name: file_digest(content.path) for content in kept})
    return {content.path: content.faults for content in faulty} | {path / FILE_NAME: []}


class _Content:
    """Holds what can be read of a file.

    Attributes:
        path: the file.
        channels: by their numbers.
        summary: times and counts of its messages.
        faults: a sentence on each part that cannot be read.
    """

    def __init__(self, path: Path):
        self.path, self.faults = path, list[str]()
        self.channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._compression = "none"
        self.summary = FileSummary(path.name)
        for record in self._records(self.faults):
            if isinstance(record, Message):
                self.summary.add(record.channel_id, record.log_time)
            elif isinstance(record, Schema):
                self._schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                self.channels.setdefault(record.id, record)
            elif isinstance(record, Chunk) and record.compression in COMPRESSIONS:
                self._compression = record.compression
        numbers, self.summary.counts = self.summary.counts, Counter()
        for number in numbers.keys() & self.channels.keys():
            self.summary.counts[self.channels[number].topic] += numbers[number]
        if unknown := numbers.total() - self.summary.counts.total():
            self.faults.append(f"{path.name}: {unknown} messages are of topics without description")

    def topics(self) -> Iterator[Topic]:
        """Yields the topics as the channels describe them, without their types' definitions."""
        for channel in self.channels.values():
            schema, has = self._schemas.get(channel.schema_id), channel.metadata
            kind, type_hash = schema.name if schema else "", has.get("topic_type_hash", "")
            qos = _profiles(has.get("offered_qos_profiles", ""))
            yield Topic(channel.topic, kind, type_hash, qos)

    def rebuild(self) -> None:
        """Sets the file aside, and writes all that can be read of it into a new one.

        Raises:
            OSError: the disk is full; the file still stands there as it did.
        """
        aside = self.path.with_name(f"{self.path.name}.unfinished")
        if not self.channels:  # the recorder was killed before the first message was on the disk
            os.replace(self.path, aside)
            return
        with replacing(self.path) as file:
            self._copy(file)
            file.flush()
            os.replace(self.path, aside)

    def _copy(self, file: BinaryIO) -> None:
        writer = Writer(file, CHUNK_SIZE, CompressionType[self._compression.upper()])
        writer.start(Profile.ROS2, "vgps_ros")
        schemas = {
            number: writer.register_schema(schema.name, schema.encoding, schema.data)
            for number, schema in self._schemas.items()
        }
        channels = {
            number: writer.register_channel(
                of.topic, of.message_encoding, schemas.get(of.schema_id, 0), of.metadata
            )
            for number, of in self.channels.items()
        }
        for of in self._records([]):
            if isinstance(of, Message) and of.channel_id in channels:
                channel = channels[of.channel_id]
                writer.add_message(channel, of.log_time, of.data, of.publish_time, of.sequence)
            elif isinstance(of, Attachment):
                writer.add_attachment(of.create_time, of.log_time, of.name, of.media_type, of.data)
        writer.finish()

    def _records(self, faults: list[str]) -> Iterator[McapRecord]:
        """Yields the whole records, and those of each chunk after it; notes what is not whole."""
        at, size, name = 0, self.path.stat().st_size, self.path.name
        with self.path.open("rb") as file:
            try:
                for record in StreamReader(file, emit_chunks=True, record_size_limit=size).records:
                    begin, at = at, file.tell()
                    yield record
                    if isinstance(record, Chunk):
                        yield from _records_in(record, f"{name}: the chunk at byte {begin}", faults)
                    elif isinstance(record, Footer) and not _has_index(file, record, at):
                        faults.append(f"{name}: its index is damaged, or there is none")
            except Exception:  # of many kinds, raised deep inside mcap
                faults.append(f"{name}: it breaks off at byte {at} of {size}")


def _profiles(text: str) -> Any:
    """Returns QoS profiles as `metadata.yaml` has them; of a text that has none, none."""
    try:
        return dump_qos_v9(parse_qos(text))
    except Exception:  # of many kinds, raised deep inside rosbags
        return []


def _records_in(chunk: Chunk, which: str, faults: list[str]) -> list[McapRecord]:
    """Returns the records of a chunk; of a damaged one none."""
    try:
        return breakup_chunk(chunk, validate_crc=True)
    except Exception:  # of many kinds, raised deep inside what unpacks it
        first, last = chunk.message_start_time * 1e-9, chunk.message_end_time * 1e-9
        faults.append(f"{which} is damaged, with messages from {first:.3f} to {last:.3f} s")
        return []


def _has_index(file: BinaryIO, footer: Footer, end: int) -> bool:
    """Returns whether a file has a whole index before the end of its footer."""
    file.seek(footer.summary_start)
    checksum = zlib.crc32(file.read(end - 4 - footer.summary_start))
    file.seek(end)
    return footer.summary_start > 0 and footer.summary_crc in (0, checksum)
