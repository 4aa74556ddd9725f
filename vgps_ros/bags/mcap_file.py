# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""One `.mcap` file of a bag: its topics, its messages, and what is damaged.

The file is framed here, record by record, and `mcap` parses each record. So a damaged record costs
only itself, and none takes more memory than its own bytes and `_LARGEST`. A file whose recorder was
killed has no index and may end within a record. Where the length of a record is damaged, reading
goes on at the next chunk that the index names; without an index the rest of the file is lost.
"""

import fcntl
import io
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC as MAGIC

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.files import read_yaml

_HEAD = struct.Struct("<BQ")  # kind and length of a record
_KINDS = set(Opcode)  # from 0x80 on there are private ones
_LARGEST = 2**28  # a chunk that claims more is damaged, or would fill the memory [bytes]
_MAGIC_AND_FOOTER = len(MAGIC) + _HEAD.size + 20  # at the end of a file [bytes]

# What mcap, zstandard and lz4 raise of bytes that are damaged.
_DAMAGED = (
    *(McapError, struct.error, UnicodeDecodeError, ValueError, RuntimeError),
    *(MemoryError, OverflowError, zstandard.ZstdError),
)


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: its full name.
        kind: its type, such as `sensor_msgs/msg/JointState`.
        type_hash: RIHS01 hash of the type, as the graph has it.
        qos: profiles that its publishers offer, as `metadata.yaml` has them.
        definition: the type's definition, with those of its fields.
        serialization: of its messages.
    """

    name: str
    kind: str
    type_hash: str
    qos: Sequence[dict[str, Any]]
    definition: str
    serialization: str = "cdr"


@dataclass(frozen=True)
class FileSummary:
    """Describes one file of a bag.

    Attributes:
        name: name of the file in the folder of the bag.
        start: time at which its first message was received [ns]; 0 if there is none.
        end: time at which its last message was received [ns]; 0 if there is none.
        counts: number of messages of each topic.
    """

    name: str
    start: int
    end: int
    counts: dict[str, int]

    @property
    def message_count(self) -> int:
        """Number of messages in the file."""
        return sum(self.counts.values())


@dataclass(frozen=True)
class Piece:
    """A whole chunk, or a message that stands outside chunks.

    Attributes:
        begin: of its record in the file [bytes].
        start: time at which its first message was received [ns].
    """

    begin: int
    start: int


class McapFile:
    """The content of a file, as far as it is whole.

    Attributes:
        path: the file.
        topics: its topics by the numbers of their channels.
        channels: the channels with their schemas, as they stand in the file.
        pieces: what holds its messages, in the order of the file.
        attachments: in the order of the file.
        compression: of the last chunk: zstd, lz4, or nothing.
        summary: times and counts of its messages.
        damages: a sentence on each part that is not whole.
        is_complete: whether it has its index and ends where it should.

    Raises:
        OSError: it cannot be read.
    """

    def __init__(self, path: Path):
        self.path = path
        self.topics: dict[int, Topic] = {}
        self.channels: dict[int, tuple[Channel, Schema | None]] = {}
        self.pieces: list[Piece] = []
        self.attachments: list[Attachment] = []
        self.compression = ""
        self.damages: list[str] = []
        self._schemas: dict[int, Schema] = {}
        self._counts: Counter[int] = Counter()
        self._start, self._end = 2**64, 0
        with path.open("rb") as file:
            index = _index_of(file)
            self.is_complete = index is not None
            for schema in index.schemas.values() if index else ():
                self._add(schema)
            for channel in index.channels.values() if index else ():
                self._add(channel)
            chunks = sorted(c.chunk_start_offset for c in index.chunk_indexes) if index else []
            self._read(file, chunks)
        counts: Counter[str] = Counter()
        for number, count in self._counts.items():
            if number in self.topics:
                counts[self.topics[number].name] += count
        if unknown := sum(n for number, n in self._counts.items() if number not in self.topics):
            self._note(f"{unknown} messages are of topics whose description is damaged")
        start = self._start if self._counts else 0
        self.summary = FileSummary(path.name, start, self._end, dict(counts))

    def messages(self, pieces: Iterable[Piece]) -> Iterator[tuple[Topic, Message]]:
        """Yields the messages of pieces with their topics.

        Raises:
            OSError: the file cannot be read.
            InvalidInputError: it was changed since it was opened.
        """
        with self.path.open("rb") as file:
            for piece in pieces:
                try:
                    kind, content = next(_records(file, piece.begin))[1:]
                    found = [_parse_record(Message, content)] if kind == Opcode.MESSAGE else None
                    records = found or breakup_chunk(_unpack_chunk(content), validate_crc=True)
                except (*_DAMAGED, StopIteration) as error:
                    raise InvalidInputError(
                        f"'{self.path}' was changed while it was read."
                    ) from error
                for record in records:
                    if isinstance(record, Message) and record.channel_id in self.topics:
                        yield self.topics[record.channel_id], record

    def _read(self, file: BinaryIO, chunks: list[int]) -> None:
        """Reads all records; `chunks` begin there by the file's index."""
        size, at = self.path.stat().st_size, len(MAGIC)
        file.seek(0)
        if file.read(len(MAGIC)) != MAGIC:
            self._note("its first bytes are damaged" if size >= len(MAGIC) else "it is cut short")
        while True:
            try:
                for begin, kind, content in _records(file, at):
                    at = begin + _HEAD.size + len(content)
                    if kind == Opcode.DATA_END:
                        break
                    self._take(begin, kind, content)
            except EndOfFile:
                found = [chunk for chunk in chunks if chunk > at]
                until = found[0] if found else size
                if until > at:
                    self._note(f"bytes {at} to {until} are damaged")
                if found:
                    at = until
                    continue
            break

    def _take(self, begin: int, kind: int, content: bytes) -> None:
        try:
            if kind == Opcode.CHUNK:
                chunk = _unpack_chunk(content)
                self._add(*breakup_chunk(chunk, validate_crc=True))
                self.compression = _parse_record(Chunk, content).compression
                self.pieces.append(Piece(begin, chunk.message_start_time))
            elif kind == Opcode.MESSAGE:
                message = _parse_record(Message, content)
                self._add(message)
                self.pieces.append(Piece(begin, message.log_time))
            elif kind == Opcode.SCHEMA:
                self._add(_parse_record(Schema, content))
            elif kind == Opcode.CHANNEL:
                self._add(_parse_record(Channel, content))
            elif kind == Opcode.ATTACHMENT:
                checksum = struct.unpack("<I", content[-4:])[0]
                if checksum and checksum != zlib.crc32(content[:-4]):
                    raise ValueError(checksum)
                self.attachments.append(_parse_record(Attachment, content))
        except _DAMAGED:
            damage = f"the {Opcode(kind).name.lower()} at byte {begin} is damaged"
            if kind == Opcode.CHUNK:
                first, last = struct.unpack("<QQ", content[:16].ljust(16, b"\0"))
                damage += f", with messages from {first * 1e-9:.3f} to {last * 1e-9:.3f} s"
            self._note(damage)

    def _add(self, *records: Any) -> None:
        """Notes the schemas, channels and messages that were read; of two schemas the first."""
        for record in records:
            if isinstance(record, Message):
                self._counts[record.channel_id] += 1
                self._start = min(self._start, record.log_time)
                self._end = max(self._end, record.log_time)
            elif isinstance(record, Schema):
                self._schemas.setdefault(record.id, record)
            elif isinstance(record, Channel) and record.id not in self.topics:
                schema = self._schemas.get(record.schema_id)
                self.channels[record.id] = record, schema
                self.topics[record.id] = _topic(record, schema)

    def _note(self, damage: str) -> None:
        self.damages.append(f"{self.path.name}: {damage}")


def is_being_written(path: Path) -> bool:
    """Returns whether a `BagWriter` of some process still writes the file."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _records(file: BinaryIO, at: int) -> Iterator[tuple[int, int, bytes]]:
    """Yields where each record begins [bytes], its kind, and its content.

    Raises:
        EndOfFile: a record ends outside the file, or is of a kind that there is not.
    """
    size = file.seek(0, io.SEEK_END)
    while True:
        file.seek(at)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise EndOfFile
        kind, length = _HEAD.unpack(head)
        if length > size - at - _HEAD.size or not (kind in _KINDS or kind >= 0x80):
            raise EndOfFile
        yield at, kind, file.read(length)
        at += _HEAD.size + length


def _parse_record(kind: Any, content: bytes) -> Any:
    """Returns a record of mcap."""
    stream = ReadDataStream(io.BytesIO(content))
    return kind.read(stream, len(content)) if kind is Message else kind.read(stream)


def _unpack_chunk(content: bytes) -> Chunk:
    """Returns a chunk whose records are not compressed.

    Raises:
        ValueError: it is larger than it claims, or than we read.
        Exception: one of _DAMAGED: it cannot be unpacked.
    """
    chunk, size = _parse_record(Chunk, content), 0
    if (size := chunk.uncompressed_size) > _LARGEST:
        raise ValueError(size)
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif chunk.compression:
        raise ValueError(chunk.compression)
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError(size)
    chunk.compression, chunk.data = "", data
    return chunk


def _index_of(file: BinaryIO) -> Summary | None:
    """Returns the index at the end of a file; None if there is none, or it is damaged."""
    try:
        file.seek(-_MAGIC_AND_FOOTER, io.SEEK_END)
        footer = file.read()
        begin, checksum = struct.unpack_from("<Q8xI", footer, _HEAD.size)
        file.seek(begin)
        content = file.read()[: -len(MAGIC) - 4]
        is_whole = footer.endswith(MAGIC) and checksum in (0, zlib.crc32(content))
        file.seek(0)
        return SeekingReader(file, record_size_limit=2**26).get_summary() if is_whole else None
    except (OSError, StopIteration, *_DAMAGED):
        return None


def _topic(channel: Channel, schema: Schema | None) -> Topic:
    try:
        qos = read_yaml(channel.metadata.get("offered_qos_profiles", "[]"), "a QoS profile")
    except InvalidInputError:
        qos = []
    return Topic(
        channel.topic,
        schema.name if schema else "",
        channel.metadata.get("topic_type_hash", ""),
        qos if isinstance(qos, list) else [],
        schema.data.decode(errors="replace") if schema else "",
        channel.message_encoding,
    )
