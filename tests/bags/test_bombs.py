# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Small untrusted files that would take much memory or time are refused, or read quickly."""

import struct
import time
import tracemalloc
from contextlib import contextmanager
from pathlib import Path

import pytest

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


def test_lengths_beyond_the_file_take_no_memory(tmp_path):
    file = Path(tmp_path, "bag_0.mcap")
    file.write_bytes(MAGIC + struct.pack("<BQ", 6, 2**50) + bytes(100))
    with within():
        assert "bytes 8 to 117 are damaged" in McapFile(file).damages[0]


def test_a_definition_that_is_none_is_refused():
    with pytest.raises(InvalidInputError, match=r"^Could not parse: [^\n]*[^.]$"):
        Decoder({"test/msg/A": "%"}).decode(bytes(100), "test/msg/A")


def test_arrays_of_numbers_may_be_large():
    decoder = Decoder({"test/msg/A": "float64[5000] x\nstring[36] names"})
    data = b"\0\1\0\0" + bytes(8 * 5000) + (struct.pack("<I", 1) + bytes(4)) * 36
    assert len(decoder.decode(data, "test/msg/A").x) == 5000
