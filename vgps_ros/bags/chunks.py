# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The chunks of an `.mcap` file, each of which is whole or not, whatever is around it.

A file is read from its start, record by record. Where a record is damaged, reading goes on with the
next one after it that proves itself by its structure and its check sum. So a damage costs what it
hit. Nothing is read that is larger than a file claims or than a limit allows.
"""

import io
import mmap
import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, ChunkIndex, Footer, Schema

Kind = TypeVar("Kind")

MAGIC = b"\x89MCAP0\r\n"
_LARGEST = 2**28  # a chunk that claims more is damaged, or would fill the memory [bytes]
_RUN = 2**20  # messages outside chunks are taken together up to this size [bytes]
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")  # start, end, uncompressed size, check sum
_MESSAGE = struct.Struct("<HIQQ")
_CANDIDATE = re.compile(rb"[\x06\x09].{5}\x00\x00\x00", re.DOTALL)  # a chunk or an attachment


class RawMessage(NamedTuple):
    """A message as it stands in a file: number of its channel, time of receipt [ns], CDR."""

    channel: int
    stamp: int
    data: bytes


@dataclass(frozen=True)
class Place:
    """A whole chunk.

    Attributes:
        begin: of its record in the file [bytes]; of messages outside chunks, of the first.
        end: of its record [bytes].
        is_run: whether it is a run of messages outside chunks.
        size: of its records, uncompressed [bytes].
        start: time at which its first message was received [ns].
        last: time at which its last message was received [ns].
        counts: number of messages by channel.
    """

    begin: int
    end: int
    is_run: bool
    size: int
    start: int
    last: int
    counts: Counter[int]


@dataclass
class Content:
    """What is whole in a file.

    Attributes:
        places: the chunks, in the order of the file.
        attachments: in the order of the file.
        schemas: by number.
        channels: by number.
        indexes: what the file's index says of its chunks; empty if it has no readable index.
        compression: of the last chunk.
        gaps: begin and end of each stretch that is damaged [bytes].
        doubled: number of chunks that were there already.
        start: when the first message was received [ns]; 0 if there is none.
        last: when the last message was received [ns].
        is_complete: whether the file has its index and ends where it should.
    """

    places: list[Place] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    indexes: list[ChunkIndex] = field(default_factory=list)
    compression: str = "none"
    gaps: list[tuple[int, int]] = field(default_factory=list)
    doubled: int = 0
    start: int = 0
    last: int = 0
    is_complete: bool = False

    def missing(self) -> list[tuple[int, ChunkIndex]]:
        """Returns the chunks of the index that are not whole, with their numbers from 1 on."""
        whole = {(place.start, place.last, place.size) for place in self.places}
        return [
            (number, index)
            for number, index in enumerate(self.indexes, start=1)
            if (index.message_start_time, index.message_end_time, index.uncompressed_size)
            not in whole
        ]


class DamagedError(Exception):
    """A record is not whole."""


def scan(path: Path) -> Content:
    """Reads a whole file once.

    Raises:
        OSError: it cannot be read.
    """
    content = Content()
    if not path.stat().st_size:
        return content
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        _Scan(data, content).run()
    return content


def messages(path: Path, place: Place) -> Iterator[RawMessage]:
    """Yields the messages of a chunk that was found whole.

    Raises:
        DamagedError: the file was changed since.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        file.seek(place.begin)
        data = file.read(place.end - place.begin)
    records = data if place.is_run else _unpacked(data[_HEAD.size :])[0]
    for kind, begin, end in _records(records):
        if kind == Opcode.MESSAGE:
            channel, _, stamp, _ = _MESSAGE.unpack_from(records, begin)
            yield RawMessage(channel, stamp, records[begin + _MESSAGE.size : end])


class _Scan:
    def __init__(self, data: mmap.mmap, content: Content):
        self._data, self._content = data, content
        self._seen: set[tuple[int, int, int]] = set()
        self._run = -1  # where a run of messages outside chunks begins; -1 outside one

    def run(self) -> None:
        """Fills in the content."""
        at = sure = len(MAGIC) if self._data[: len(MAGIC)] == MAGIC else 0
        size = len(self._data)
        while at < size:
            try:
                kind, end = self._head(at, size)
                if self._run >= 0 and not self._belongs_to_run(kind, end):
                    self._end_run(at)
                    sure = at
                if self._take(kind, at, end):
                    sure = end
                at = end
                if kind == Opcode.FOOTER:
                    if self._data[at:] != MAGIC:
                        raise DamagedError
                    self._content.is_complete = True
                    break
            except (DamagedError, struct.error):
                if self._run >= 0:
                    self._end_run(at)
                    sure = at
                # What has no check sum and led here may be what is damaged, so it is read again.
                at = self._next(sure + (sure == at))
                self._content.gaps.append((sure, at))
                sure = at
        if self._run >= 0:
            self._end_run(min(at, size))
        self._read_summary()

    def _head(self, at: int, size: int) -> tuple[int, int]:
        if at + _HEAD.size > size:
            raise DamagedError
        kind, length = _HEAD.unpack_from(self._data, at)
        end = at + _HEAD.size + length
        if end > size or not (1 <= kind <= Opcode.DATA_END or kind >= 0x80):
            raise DamagedError
        return kind, end

    def _belongs_to_run(self, kind: int, end: int) -> bool:
        is_content = kind in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
        return is_content and end - self._run <= _RUN

    def _take(self, kind: int, at: int, end: int) -> bool:
        """Takes a record; returns whether it has proven that it is whole."""
        if kind == Opcode.CHUNK:
            self._take_chunk(at, end)
            return True
        if kind == Opcode.ATTACHMENT:
            self._content.attachments.append(_attachment(self._data[at + _HEAD.size : end]))
            return True
        if kind in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE) and self._run < 0:
            self._run = at
        return False

    def _take_chunk(self, at: int, end: int) -> None:
        records, compression, checksum = _unpacked(self._data[at + _HEAD.size : end])
        key = (checksum, len(records), zlib.crc32(records))
        if key in self._seen:
            self._content.doubled += 1
            return
        self._add(Place(at, end, False, len(records), *self._survey(records)))
        self._seen.add(key)
        self._content.compression = compression or "none"

    def _end_run(self, at: int) -> None:
        begin, self._run = self._run, -1
        try:
            found = self._survey(self._data[begin:at])
        except (DamagedError, struct.error):
            self._content.gaps.append((begin, at))
        else:
            self._add(Place(begin, at, True, at - begin, *found))

    def _add(self, place: Place) -> None:
        if place.counts:
            self._content.places.append(place)

    def _survey(self, records: bytes) -> tuple[int, int, Counter[int]]:
        """Reads schemas and channels; returns first and last time and counts of the messages."""
        content, counts, stamps = self._content, Counter[int](), []
        for kind, begin, end in _records(records):
            if kind == Opcode.MESSAGE:
                channel, _, stamp, _ = _MESSAGE.unpack_from(records, begin)
                counts[channel] += 1
                stamps.append(stamp)
            else:
                _define(content, kind, records[begin:end])
        first, last = min(stamps, default=0), max(stamps, default=0)
        if stamps:
            content.start = min(content.start or first, first)
            content.last = max(content.last, last)
        return first, last, counts

    def _next(self, at: int) -> int:
        """Returns where the next whole chunk or attachment begins, or the end of the file."""
        for candidate in _CANDIDATE.finditer(self._data, at):
            begin = candidate.start()
            try:
                kind, end = self._head(begin, len(self._data))
                body = self._data[begin + _HEAD.size : end]
                if kind == Opcode.CHUNK:
                    _unpacked(body)
                else:
                    _attachment(body)
            except (DamagedError, struct.error):
                continue
            return begin
        return len(self._data)

    def _read_summary(self) -> None:
        """Reads the index, whose check sum covers it; schemas and channels stand there again."""
        data, content = self._data, self._content
        footer = len(data) - len(MAGIC) - _HEAD.size - 20
        if footer < 0 or data[-len(MAGIC) :] != MAGIC or data[footer] != Opcode.FOOTER:
            content.is_complete = False
            return
        found = _parsed(Footer, data[footer + _HEAD.size : footer + _HEAD.size + 20])
        begin = found.summary_start
        covered = data[begin : len(data) - len(MAGIC) - 4] if 0 < begin <= footer else b""
        if found.summary_crc and zlib.crc32(covered) != found.summary_crc:
            content.is_complete = False
            return
        try:
            for kind, first, end in _records(data[begin:footer] if begin else b""):
                record = data[begin + first : begin + end]
                if kind == Opcode.CHUNK_INDEX:
                    content.indexes.append(_parsed(ChunkIndex, record))
                else:
                    _define(content, kind, record)
        except (DamagedError, struct.error):
            content.is_complete = False
        else:  # the damage before it, which the scan may not have got past, is told by the index
            content.is_complete |= bool(content.indexes)


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yields kind, begin and end of each record in bytes that hold nothing but whole records."""
    at, size = 0, len(data)
    while at < size:
        if at + _HEAD.size > size:
            raise DamagedError
        kind, length = _HEAD.unpack_from(data, at)
        begin = at + _HEAD.size
        at = begin + length
        if at > size:
            raise DamagedError
        yield kind, begin, at


def _unpacked(body: bytes) -> tuple[bytes, str, int]:
    """Returns the records of a chunk, its compression and its check sum."""
    _, _, size, checksum = _CHUNK.unpack_from(body)
    at = _CHUNK.size + 4
    length = int.from_bytes(body[_CHUNK.size : at], "little")
    compression = body[at : at + length] if length <= 4 else b"?"
    at += length + 8
    if size > _LARGEST or len(body) - at != int.from_bytes(body[at - 8 : at], "little"):
        raise DamagedError
    try:
        if compression == b"zstd":
            records = zstandard.ZstdDecompressor().decompress(body[at:], max_output_size=size)
        elif compression == b"lz4":
            records = lz4.frame.LZ4FrameDecompressor().decompress(body[at:], max_length=size)
        else:
            records = body[at:]
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise DamagedError from error
    is_known = compression in (b"", b"lz4", b"zstd")
    if not is_known or len(records) != size or (checksum and zlib.crc32(records) != checksum):
        raise DamagedError
    return records, compression.decode(), checksum


def _attachment(body: bytes) -> Attachment:
    attachment = _parsed(Attachment, body)
    checksum = int.from_bytes(body[-4:], "little")
    length = 16 + 4 + len(attachment.name.encode()) + 4 + len(attachment.media_type.encode())
    if len(body) != length + 8 + len(attachment.data) + 4:
        raise DamagedError
    if checksum and zlib.crc32(body[:-4]) != checksum:
        raise DamagedError
    return attachment


def _define(content: Content, kind: int, record: bytes) -> None:
    """Notes a schema or a channel; of two with one number the first counts."""
    if kind == Opcode.SCHEMA:
        schema = _parsed(Schema, record)
        content.schemas.setdefault(schema.id, schema)
    elif kind == Opcode.CHANNEL:
        channel = _parsed(Channel, record)
        content.channels.setdefault(channel.id, channel)


def _parsed(kind: type[Kind], record: bytes) -> Kind:
    """Returns a record; whatever is wrong with its bytes makes it a damaged one."""
    try:
        return kind.read(ReadDataStream(io.BytesIO(record)))  # type: ignore[attr-defined]
    except (McapError, struct.error, ValueError, MemoryError, OverflowError) as error:
        raise DamagedError from error
