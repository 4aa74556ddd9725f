# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The records of an `.mcap` file as bytes, each of which is whole or is refused.

Nothing is read that is larger than its bytes claim or than a limit allows.
"""

import io
import mmap
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Attachment

Kind = TypeVar("Kind")
Bytes = bytes | mmap.mmap

MAGIC = b"\x89MCAP0\r\n"  # with which a file begins and ends
HEAD = struct.Struct("<BQ")  # kind and length of a record
MESSAGE = struct.Struct("<HIQQ")  # channel, number, times of receipt and of sending [ns]
_CHUNK = struct.Struct("<QQQI")  # start, end, uncompressed size, check sum
_LENGTH, _LONG_LENGTH = struct.Struct("<I"), struct.Struct("<Q")
LARGEST = 2**28  # a chunk that claims more is damaged, or would fill the memory [bytes]


class DamagedError(Exception):
    """A record is not whole."""


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yields kind, begin and end of each record in bytes that hold nothing but whole records.

    Raises:
        DamagedError: they do not.
    """
    at, size = 0, len(data)
    while at < size:
        if at + HEAD.size > size:
            raise DamagedError
        kind, length = HEAD.unpack_from(data, at)
        begin = at + HEAD.size
        at = begin + length
        if at > size:
            raise DamagedError
        yield kind, begin, at


class ChunkHead(NamedTuple):
    """Tells what a chunk says of its records.

    Attributes:
        at: where they begin in the bytes.
        size: how long they are, uncompressed [bytes].
        compression: lz4, zstd or nothing.
        checksum: of them, uncompressed; 0 if there is none.
    """

    at: int
    size: int
    compression: bytes
    checksum: int


def chunk_head(data: Bytes, begin: int, end: int) -> ChunkHead:
    """Returns what the chunk between two places says of its records, which are not read.

    Raises:
        DamagedError: its lengths contradict each other, or it claims too much.
        struct.error: it ends too early.
    """
    _, _, size, checksum = _CHUNK.unpack_from(data, begin)
    at = begin + _CHUNK.size
    (length,) = _LENGTH.unpack_from(data, at)
    if length > 4:
        raise DamagedError
    compression = bytes(data[at + 4 : at + 4 + length])
    at += 4 + length
    (packed,) = _LONG_LENGTH.unpack_from(data, at)
    at += _LONG_LENGTH.size
    if size > LARGEST or end - at != packed or compression not in (b"", b"lz4", b"zstd"):
        raise DamagedError
    if not compression and size != packed:
        raise DamagedError
    return ChunkHead(at, size, compression, checksum)


def unpacked(body: bytes) -> tuple[bytes, str, int]:
    """Returns the records of a chunk, its compression and its check sum.

    Raises:
        DamagedError: they contradict its check sum or its sizes.
        struct.error: it ends too early.
    """
    at, size, compression, checksum = chunk_head(body, 0, len(body))
    content = body[at:]
    try:
        if compression == b"zstd":
            # Where a frame states its size, the decompressor would heed no other limit.
            if zstandard.frame_content_size(content) not in (size, -1):
                raise DamagedError
            content = zstandard.ZstdDecompressor().decompress(content, max_output_size=size)
        elif compression == b"lz4":
            content = lz4.frame.LZ4FrameDecompressor().decompress(content, max_length=size)
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise DamagedError from error
    if len(content) != size or (checksum and zlib.crc32(content) != checksum):
        raise DamagedError
    return content, compression.decode(), checksum


def require_attachment(data: Bytes, begin: int, end: int) -> None:
    """Checks the lengths of the attachment between two places, whose content is not read.

    Raises:
        DamagedError: they contradict each other.
        struct.error: it ends too early.
    """
    at = begin + 16
    for _ in ("name", "type"):
        at += _LENGTH.size + _LENGTH.unpack_from(data, at)[0]
    if at + _LONG_LENGTH.size + _LONG_LENGTH.unpack_from(data, at)[0] + 4 != end:
        raise DamagedError


def attachment(body: bytes) -> Attachment:
    """Returns an attachment.

    Raises:
        DamagedError: its bytes contradict its check sum or its sizes.
        struct.error: it ends too early.
    """
    require_attachment(body, 0, len(body))
    checksum = int.from_bytes(body[-4:], "little")
    if checksum and zlib.crc32(body[:-4]) != checksum:
        raise DamagedError
    return parsed(Attachment, body)


def parsed(kind: type[Kind], record: bytes) -> Kind:
    """Returns a record.

    Raises:
        DamagedError: anything is wrong with its bytes.
    """
    try:
        return kind.read(ReadDataStream(io.BytesIO(record)))  # type: ignore[attr-defined]
    except (McapError, struct.error, ValueError, MemoryError, OverflowError) as error:
        raise DamagedError from error
