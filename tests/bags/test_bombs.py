# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Small files of strangers that would take much memory or time are refused, or read quickly."""

import struct
import time
import tracemalloc
import zlib
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import pytest
import zstandard

from vgps_ros.bags.decoder import Decoder
from vgps_ros.bags.mcap_bytes import MAGIC, DamagedError, unpacked
from vgps_ros.bags.scan import scan
from vgps_ros.core.errors import InvalidInputError


@contextmanager
def within(*, seconds: float = 6.0, megabytes: float = 30.0):
    """Checks how much of the processor and of the memory is taken."""
    begin = time.process_time()
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < megabytes * 1e6
    finally:
        tracemalloc.stop()
    assert time.process_time() - begin < seconds


def chunk(content: bytes, *, size: int, compression: bytes = b"", checksum: int = 0) -> bytes:
    packed = struct.pack("<Q", len(content)) + content
    head = struct.pack("<QQQII", 1, 1, size, checksum, len(compression)) + compression
    return head + packed


@pytest.mark.parametrize(
    ("compression", "compress"), [(b"zstd", zstandard.compress), (b"lz4", lz4.frame.compress)]
)
def test_a_chunk_that_would_become_larger_than_it_claims_is_refused(compression, compress):
    bomb = compress(bytes(10**8))
    with within(), pytest.raises(DamagedError):
        unpacked(chunk(bomb, size=100, compression=compression, checksum=1))
    whole = compress(bytes(100))
    body = chunk(whole, size=100, compression=compression, checksum=zlib.crc32(bytes(100)))
    assert unpacked(body)[0] == bytes(100)


def _overlapping(count: int, checksum: int) -> bytes:
    """Chunks that begin one after the other, each with the next one and one byte more."""
    parts, size = [bytes(count)], 1
    for _ in range(count):
        body = chunk(b"", size=size, checksum=checksum)[:-8] + struct.pack("<Q", size)
        parts += [body, struct.pack("<BQ", 6, len(body) + size)]
        size += len(body) + 9 + 1
    return b"".join(reversed(parts))


@pytest.mark.parametrize(
    "data",
    [
        bytes(9)
        + (struct.pack("<BQ", 6, 2_000_000) + bytes(91)) * 40_000,  # "chunks" of half the file
        _overlapping(30_000, checksum=0),
        _overlapping(30_000, checksum=1),
    ],
    ids=["lengths", "unchecked", "wrong"],
)
def test_a_search_among_chunks_that_overlap_takes_time_in_proportion(tmp_path, data):
    file = Path(tmp_path, "bag_0.mcap")
    file.write_bytes(MAGIC + data)
    with within():
        assert scan(file).gaps


@pytest.mark.parametrize(
    ("definition", "sentence"),
    [
        ("string[300000] name", "300000 texts and messages in arrays of a fixed size"),
        ("X[600] a\nX[600] b\n" + 80 * "=" + "\nMSG: test/X\nuint8 x", "there are 1200 texts"),
        ("uint8 x\n" * 100_000, "has 800000 characters, and at most 262144 are read"),
        ("%", r"^Could not parse: [^\n]*[^.]$"),
    ],
)
def test_a_definition_that_would_become_large_or_is_none_is_refused(definition, sentence):
    with within(), pytest.raises(InvalidInputError, match=sentence):
        Decoder({"test/msg/A": definition}).decode(bytes(100), "test/msg/A")


def test_arrays_of_numbers_may_be_large():
    decoder = Decoder({"test/msg/A": "float64[5000] x\nstring[36] names"})
    data = b"\0\1\0\0" + bytes(8 * 5000) + (struct.pack("<I", 1) + bytes(4)) * 36
    assert len(decoder.decode(data, "test/msg/A").x) == 5000
