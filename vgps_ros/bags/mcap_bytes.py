# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The records of an `.mcap` file as bytes, each of which is whole or is refused.

Nothing is read that is larger than its bytes claim or than a limit allows.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from typing import TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Attachment

Kind = TypeVar("Kind")

MAGIC = b"\x89MCAP0\r\n"  # with which a file begins and ends
HEAD = struct.Struct("<BQ")  # kind and length of a record
MESSAGE = struct.Struct("<HIQQ")  # channel, number, times of receipt and of sending [ns]
_CHUNK = struct.Struct("<QQQI")  # start, end, uncompressed size, check sum
_LARGEST = 2**28  # a chunk that claims more is damaged, or would fill the memory [bytes]


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


def unpacked(body: bytes) -> tuple[bytes, str, int]:
    """Returns the records of a chunk, its compression and its check sum.

    Raises:
        DamagedError: they contradict its check sum or its sizes.
        struct.error: it ends too early.
    """
    _, _, size, checksum = _CHUNK.unpack_from(body)
    at = _CHUNK.size + 4
    length = int.from_bytes(body[_CHUNK.size : at], "little")
    compression = body[at : at + length] if length <= 4 else b"?"
    at += length + 8
    if size > _LARGEST or len(body) - at != int.from_bytes(body[at - 8 : at], "little"):
        raise DamagedError
    try:
        if compression == b"zstd":
            content = zstandard.ZstdDecompressor().decompress(body[at:], max_output_size=size)
        elif compression == b"lz4":
            content = lz4.frame.LZ4FrameDecompressor().decompress(body[at:], max_length=size)
        else:
            content = body[at:]
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise DamagedError from error
    is_known = compression in (b"", b"lz4", b"zstd")
    if not is_known or len(content) != size or (checksum and zlib.crc32(content) != checksum):
        raise DamagedError
    return content, compression.decode(), checksum


def attachment(body: bytes) -> Attachment:
    """Returns an attachment.

    Raises:
        DamagedError: its bytes contradict its check sum or its sizes.
    """
    found = parsed(Attachment, body)
    checksum = int.from_bytes(body[-4:], "little")
    length = 16 + 4 + len(found.name.encode()) + 4 + len(found.media_type.encode())
    if len(body) != length + 8 + len(found.data) + 4:
        raise DamagedError
    if checksum and zlib.crc32(body[:-4]) != checksum:
        raise DamagedError
    return found


def parsed(kind: type[Kind], record: bytes) -> Kind:
    """Returns a record.

    Raises:
        DamagedError: anything is wrong with its bytes.
    """
    try:
        return kind.read(ReadDataStream(io.BytesIO(record)))  # type: ignore[attr-defined]
    except (McapError, struct.error, ValueError, MemoryError, OverflowError) as error:
        raise DamagedError from error
