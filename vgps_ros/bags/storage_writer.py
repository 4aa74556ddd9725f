"""One `.mcap` file of a rosbag2 bag, written with its index."""

import struct
from collections import deque
from typing import IO, NamedTuple

import yaml
from mcap._chunk_builder import ChunkBuilder
from mcap.opcode import Opcode
from mcap.records import Message, MessageIndex
from mcap.writer import CompressionType, Writer

from vgps_ros.bags.storage import Topic
from vgps_ros.core.checks import one_of
from vgps_ros.storage.disk import DiskFile

COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}

_CHUNK_SIZE = 2**18  # small enough that decoding one does not hold up a replay [bytes]

# Of a message's record: kind, length, channel, sequence number, when received, when published.
_MESSAGE_HEADER = struct.Struct("<BQHIQQ")
_LENGTH_BEFORE_DATA = _MESSAGE_HEADER.size - struct.calcsize("<BQ")


class _Mark(NamedTuple):
    """What a file holds up to a position where it may be cut."""

    position: int
    num_chunks: int
    num_attachments: int
    message_counts: dict[int, int]
    start: int
    end: int


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

    Args:
        file: empty; each block that is handed over to it ends with a whole record.
        compression: of the chunks: none, lz4 or zstd.
    """

    def __init__(self, file: DiskFile | IO[bytes], compression: str):
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._file = file
        self._mcap = Writer(
            file,  # type: ignore[arg-type]
            chunk_size=_CHUNK_SIZE,
            compression=COMPRESSIONS[one_of("compression", compression, COMPRESSIONS)],
        )
        self._mcap.start(profile="ros2", library="vgps_ros")
        # The library counts, and closes a chunk once it is full, but has no public call for either;
        # to count again here would take time for every message. Nor can its chunk be named.
        self._mcap._Writer__chunk_builder = _MessageChunk()  # type: ignore[attr-defined]
        self._statistics = self._mcap._Writer__statistics  # type: ignore[attr-defined]
        self._write_chunk = self._mcap._Writer__finalize_chunk  # type: ignore[attr-defined]
        self._mcap._Writer__finalize_chunk = self._finish_chunk  # type: ignore[attr-defined]
        self._marks: deque[_Mark] = deque()
        self._mark()

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
        self._finish_chunk()  # so that the file can be cut after it
        self._mcap.add_attachment(stamp, stamp, name, "text/plain", data)
        self._mark()

    def flush(self) -> None:
        """Hands all messages so far to the file: a killed process loses none that it wrote."""
        self._finish_chunk()
        self._file.flush()

    def close(self, metadata: str) -> None:
        """Completes the file: metadata as rosbag2 puts it there, and the index."""
        self._finish_chunk()
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": metadata})
        self._mcap.finish()
        self._file.close()

    def keep(self, position: int) -> None:
        """Notes that all up to a position is safe, so that it will not go back before it."""
        while len(self._marks) > 1 and self._marks[1].position <= position:
            self._marks.popleft()

    def go_back(self, position: int) -> int:
        """Forgets what came after a position, also an index; the file can then be closed again.

        Args:
            position: end of what is whole in the file [bytes].

        Returns:
            Where the file must be cut: after the last chunk with its index, or attachment.
        """
        self.keep(position)
        mark = self._marks[0]
        self._marks = deque([mark])
        mcap, statistics = self._mcap, self._statistics
        del mcap._Writer__chunk_indices[mark.num_chunks :]  # type: ignore[attr-defined]
        del mcap._Writer__attachment_indexes[mark.num_attachments :]  # type: ignore[attr-defined]
        mcap._Writer__metadata_indexes.clear()  # type: ignore[attr-defined]
        mcap._Writer__summary_offsets.clear()  # type: ignore[attr-defined]
        mcap._Writer__chunk_builder = _MessageChunk()  # type: ignore[attr-defined]
        statistics.channel_message_counts.clear()
        statistics.channel_message_counts.update(mark.message_counts)
        statistics.message_count = sum(mark.message_counts.values())
        statistics.message_start_time, statistics.message_end_time = mark.start, mark.end
        statistics.chunk_count = mark.num_chunks
        statistics.attachment_count = mark.num_attachments
        statistics.metadata_count = 0
        return mark.position

    def _finish_chunk(self) -> None:
        self._write_chunk()
        self._mark()

    def _mark(self) -> None:
        position, statistics = self._file.tell(), self._statistics
        if self._marks and self._marks[-1].position == position:
            return
        self._marks.append(
            _Mark(
                position,
                statistics.chunk_count,
                statistics.attachment_count,
                dict(statistics.channel_message_counts),
                statistics.message_start_time,
                statistics.message_end_time,
            )
        )
