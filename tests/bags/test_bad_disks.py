# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Bags on a full or slow disk: what it took can be read."""

import os
import re
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from vgps_ros.bags import BagReader, BagWriter
from vgps_ros.bags.repair import repair
from vgps_ros.bags.writer import UnfinishedBagError

KIND = "sensor_msgs/msg/JointState"
HASH = get_typestore(Stores.ROS2_JAZZY).hash_rihs01(KIND)
SIZE = 1000  # of a message [bytes]


@contextmanager
def limited(size: float) -> Iterator[None]:
    """No file may grow beyond a size [bytes]: as a full disk, without one."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(size), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


class Bag(BagWriter):
    """A bag with one topic, whose messages are numbered."""

    def __init__(self, path: Path, **settings):
        super().__init__(path, **settings)
        self.add_topic("/a", KIND, HASH, [])
        self.count = 0

    def fill(self, count: int) -> None:
        for _ in range(count):
            self.count += 1
            self.write("/a", self.count, self.count.to_bytes(4, "little") + bytes(SIZE - 4))


def numbers(path: Path) -> list[int]:
    with AnyReader([path]) as reader:
        found = []
        for _, stamp, data in reader.messages():
            assert int.from_bytes(data[:4], "little") == stamp
            found.append(stamp)
    return found


# The space is used up by a chunk, within one, within the index, and in the second file of several.
@pytest.mark.parametrize(
    ("size", "settings"),
    [
        *((size, {}) for size in (100, 5_000, 280_000, 527_200, 790_000)),
        *((size, {"max_file_size": 1_000_000}) for size in (785_000, 790_000)),
        (5_000, {"compression": "lz4"}),
    ],
)
def test_closed_on_a_full_disk_it_keeps_what_the_disk_took(tmp_path, size, settings):
    bag = Bag(tmp_path / "bag", **settings)
    bag.attach("parameters.yaml", "seed: 3", 1)
    bag.fill(1)
    bag.flush()
    sentence = ""
    with limited(size):
        bag.fill(2999)
        try:
            bag.close()
        except UnfinishedBagError as error:
            sentence = str(error)
    assert bool(repair(bag.path)) == bool(sentence)
    if sentence:
        assert re.search("File too large; make room .*bag reindex", sentence)
    assert numbers(bag.path) == list(range(1, bag.message_count + 1))
    assert bag.message_count + bag.lost == 3000
    with BagReader(bag.path) as reader:
        assert reader.attachments() == {"parameters.yaml": "seed: 3"}


def test_a_slow_disk_holds_nothing_up_and_what_is_too_much_is_counted(tmp_path, gate):
    bag = Bag(tmp_path / "bag", max_backlog=5_000_000)
    bag.flush()
    gate.clear()
    bag.fill(10_000)  # would not return if it waited
    assert 5_000_000 < bag.backlog < 6_000_000
    assert 4_000 < bag.lost < 5_500
    assert not bag.fault
    gate.set()
    bag.flush()
    kept = bag.message_count
    bag.fill(1)
    bag.close()
    # The writer may take a part of them while others are lost, so that one fits in between.
    found = numbers(bag.path)
    assert found == sorted(set(found))
    assert (found[:4_000], found[-1]) == ([*range(1, 4_001)], 10_001)
    assert len(found) == kept + 1
    assert kept + bag.lost == 10_000


def test_the_end_waits_for_a_slow_disk(tmp_path, monkeypatch):
    write = os.pwrite

    def slow(*arguments) -> int:
        time.sleep(0.1)
        return write(*arguments)

    monkeypatch.setattr(os, "pwrite", slow)
    bag = Bag(tmp_path / "bag")
    bag.fill(2000)
    bag.close()
    assert bag.lost == 0
    assert numbers(bag.path) == list(range(1, 2001))


def test_a_bag_whose_metadata_cannot_be_written_says_so(tmp_path):
    bag = Bag(tmp_path / "bag")
    bag.fill(10)
    (bag.path / "metadata.yaml").mkdir()
    with pytest.raises(UnfinishedBagError, match=r"metadata\.yaml cannot be written, Is"):
        bag.close()
    (bag.path / "metadata.yaml").rmdir()
    assert [file.name for file in bag.path.iterdir()] == ["bag_0.mcap"]
    repair(bag.path)
    assert numbers(bag.path) == list(range(1, 11))


@pytest.mark.parametrize("full", ["rebuilt", "metadata"])
def test_a_full_disk_stops_reindexing_and_changes_nothing(tmp_path, full):
    bag = Bag(tmp_path / "bag")
    bag.fill(500)
    bag.flush()
    killed = tmp_path / "killed"
    killed.mkdir()
    (killed / "bag_0.mcap").write_bytes((bag.path / "bag_0.mcap").read_bytes())
    bag.close()
    before = (killed / "bag_0.mcap").read_bytes()
    with (
        limited(300_000 if full == "rebuilt" else len(before) + 100),
        pytest.raises(OSError, match="too large"),
    ):
        repair(killed)
    assert {f.name: f.read_bytes() for f in killed.iterdir()} == {"bag_0.mcap": before}
    repair(killed)
    assert numbers(killed) == list(range(1, 501))
