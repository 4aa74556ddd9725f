# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Small untrusted files that would take much memory or time are refused, or read quickly."""

import struct
import time
import tracemalloc
import zlib
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk

from vgps_ros.bags.mcap_file import MAGIC, McapFile
from vgps_ros.bags.reader import Decoder
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


@pytest.mark.parametrize(
    ("compression", "compress"), [("zstd", zstandard.compress), ("lz4", lz4.frame.compress)]
)
@pytest.mark.parametrize("claimed", [100, pytest.param(10**8, marks=pytest.mark.slow), 2**40])
def test_a_chunk_that_would_become_large_is_refused(tmp_path, compression, compress, claimed):
    builder = RecordBuilder()
    for content in (bytes(10**9), b"") if claimed > 100 else (bytes(10**8), b""):
        packed = compress(content)
        size = claimed if content else 0
        Chunk(compression, packed, 1, 1, zlib.crc32(content), size).write(builder)
        del content
    file = Path(tmp_path, "bag_0.mcap")
    file.write_bytes(MAGIC + builder.end())
    with within(megabytes=300.0 if claimed == 10**8 else 30.0):
        content = McapFile(file)
    assert len(content.pieces) == 1
    assert "is damaged, with messages from" in content.damages[0]


def test_lengths_beyond_the_file_take_no_memory(tmp_path):
    file = Path(tmp_path, "bag_0.mcap")
    file.write_bytes(MAGIC + struct.pack("<BQ", 6, 2**50) + bytes(100))
    with within():
        assert "bytes 8 to 117 are damaged" in McapFile(file).damages[0]


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
