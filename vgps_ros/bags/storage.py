"""One `.mcap` file of a rosbag2 bag: written with its index, read as far as it goes.

A file whose writer was killed has no index and may end within a record; all before that is read.
"""

import fcntl
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from mcap._chunk_builder import ChunkBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    Footer,
    McapRecord,
    Message,
    MessageIndex,
    Schema,
)
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from vgps_ros.core.checks import one_of

COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}

_CHUNK_SIZE = 2**18  # small enough that decoding one does not hold up a replay [bytes]


# Of a message's record: kind, length, channel, sequence number, when received, when published.
_MESSAGE_HEADER = struct.Struct("<BQHIQQ")
_LENGTH_BEFORE_DATA = _MESSAGE_HEADER.size - struct.calcsize("<BQ")


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
    definition: str


class _MessageChunk(ChunkBuilder):
    """The library's chunk, but a message's header is written at once, not field by field."""

    def add_message(self, message: Message) -> None:
        """Adds a message and its place in the index."""
        stamp, offset = message.log_time, self.record_writer.count
        if not self.num_messages or stamp < self.message_start_time:
            self.message_start_time = stamp
        self.message_end_time = max(self.message_end_time, stamp)
        index = self.message_indices.get(message.channel_id)
        if index is None:
            index = self.message_indices[message.channel_id] = MessageIndex(message.channel_id, [])
        index.records.append((stamp, offset))
        self.num_messages += 1
        length = _LENGTH_BEFORE_DATA + len(message.data)
        self.record_writer.write(
            _MESSAGE_HEADER.pack(
                Opcode.MESSAGE, length, message.channel_id, message.sequence, stamp,
                message.publish_time,
            )
        )  # fmt: skip
        self.record_writer.write(message.data)


class StorageWriter:
    """A file that is being written.

    Attributes:
        path: the file.
    """

    def __init__(self, path: Path, compression: str):
        self.path = path
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._file = path.open("xb")
        fcntl.flock(self._file, fcntl.LOCK_EX)  # see is_being_written
        self._mcap = Writer(
            self._file,
            chunk_size=_CHUNK_SIZE,
            compression=COMPRESSIONS[one_of("compression", compression, COMPRESSIONS)],
        )
        self._mcap.start(profile="ros2", library="vgps_ros")
        # The library counts, and closes a chunk once it is full, but has no public call for either;
        # to count again here would take time for every message. Nor can its chunk be named.
        self._mcap._Writer__chunk_builder = _MessageChunk()  # type: ignore[attr-defined]
        self._statistics = self._mcap._Writer__statistics  # type: ignore[attr-defined]
        self._close_chunk = self._mcap._Writer__finalize_chunk  # type: ignore[attr-defined]

    @property
    def counts(self) -> dict[str, int]:
        """Messages of each topic so far."""
        counts = self._statistics.channel_message_counts
        return {topic: counts.get(channel, 0) for topic, channel in self._channels.items()}

    @property
    def start(self) -> int:
        """When the first message was received [ns]; 0 if there is none."""
        start: int = self._statistics.message_start_time
        return start

    @property
    def end(self) -> int:
        """When the last message was received [ns]; 0 if there is none."""
        end: int = self._statistics.message_end_time
        return end

    @property
    def size(self) -> int:
        """Bytes written, without those of the chunk that is still open."""
        return self._file.tell()

    def add_topic(self, topic: Topic) -> None:
        """Makes a topic known, before its first message."""
        if topic.kind not in self._schemas:
            self._schemas[topic.kind] = self._mcap.register_schema(
                topic.kind, "ros2msg", topic.definition.encode()
            )
        self._channels[topic.name] = self._mcap.register_channel(
            topic.name,
            "cdr",
            self._schemas[topic.kind],
            {
                "offered_qos_profiles": yaml.safe_dump(list(topic.qos), sort_keys=False),
                "topic_type_hash": topic.type_hash,
            },
        )

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Writes a message that was received at a time [ns]."""
        self._mcap.add_message(self._channels[topic], stamp, data, stamp)

    def attach(self, name: str, data: bytes, stamp: int) -> None:
        """Adds a named text; of several with one name the last one counts."""
        self._mcap.add_attachment(stamp, stamp, name, "text/plain", data)

    def flush(self) -> None:
        """Hands all messages so far to the operating system: a killed process loses none."""
        self._close_chunk()
        self._file.flush()

    def close(self, metadata: str) -> None:
        """Completes the file: metadata as rosbag2 puts it there, and the index."""
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": metadata})
        self._mcap.finish()
        self._file.close()


def is_being_written(path: Path) -> bool:
    """Returns whether some process still writes the file."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


@dataclass(frozen=True)
class StorageContent:
    """What can be read of a file.

    Attributes:
        topics: by their names.
        counts: messages of each topic.
        start: when the first message was received [ns].
        end: when the last one was.
        compression: of its chunks.
        is_complete: whether it has its index and ends where it should.
    """

    topics: dict[str, Topic]
    counts: dict[str, int]
    start: int
    end: int
    compression: str
    is_complete: bool


class StorageScan:
    """Reads a file from its start, record by record, as far as it is whole.

    Attributes:
        topics: those seen so far, by the ids of their channels.
        compression: of the chunks.
        is_complete: after `records` has ended, whether the file did so properly.
    """

    def __init__(self, path: Path):
        self.topics: dict[int, Topic] = {}
        self.compression = "none"
        self.is_complete = False
        self._path = path
        self._schemas: dict[int, Schema] = {}

    def records(self) -> Iterator[tuple[Topic, Message] | Attachment]:
        """Yields messages with their topics, and attachments, in the order of the file."""
        for record in self._whole_records():
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self.topics.setdefault(record.id, self._topic(record))
            elif isinstance(record, Message):
                yield self.topics[record.channel_id], record
            elif isinstance(record, Attachment):
                yield record

    def content(self) -> StorageContent:
        """Reads the whole file and returns what is in it."""
        counts: dict[str, int] = {}
        start = end = 0
        for record in self.records():
            if not isinstance(record, Attachment):
                topic, message = record
                counts[topic.name] = counts.get(topic.name, 0) + 1
                start = min(start or message.log_time, message.log_time)
                end = max(end, message.log_time)
        topics = {topic.name: topic for topic in self.topics.values()}
        return StorageContent(
            topics,
            {name: counts.get(name, 0) for name in topics},
            start,
            end,
            self.compression,
            self.is_complete,
        )

    def _whole_records(self) -> Iterator[McapRecord]:
        with self._path.open("rb") as file:
            try:
                for record in StreamReader(file, emit_chunks=True).records:
                    if isinstance(record, Chunk):
                        self.compression = record.compression or "none"
                        yield from breakup_chunk(record, validate_crc=True)
                    else:
                        self.is_complete = isinstance(record, Footer)
                        yield record
            except OSError:
                raise
            except Exception:
                self.is_complete = False

    def _topic(self, channel: Channel) -> Topic:
        schema = self._schemas[channel.schema_id]
        return Topic(
            channel.topic,
            schema.name,
            channel.metadata.get("topic_type_hash", ""),
            yaml.safe_load(channel.metadata.get("offered_qos_profiles", "[]")) or [],
            schema.data.decode(),
        )
