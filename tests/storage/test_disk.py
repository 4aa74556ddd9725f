# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A slow, full or hanging disk: nobody waits for it, and what it took can be read."""

import os
import re
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import EFBIG
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from vgps_ros.bags import BagReader, BagWriter
from vgps_ros.bags.reindex import missing_parts, reindex
from vgps_ros.bags.writer import UnfinishedBagError
from vgps_ros.core.errors import InvalidInputError

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


def test_when_there_is_space_again_it_goes_on_and_nothing_is_lost(tmp_path):
    bag = Bag(tmp_path / "bag")
    with limited(1_000_000):
        bag.fill(2000)
        bag.flush()
        assert bag.disk.fault.number == EFBIG
        assert bag.disk.fault.path.name == "bag_0.mcap"
        assert "MB are free there" in bag.disk.fault.reason
        assert "ulimit -f" in bag.disk.fault.next_step
        assert bag.disk.backlog > 1_000_000
    bag.fill(1000)
    bag.flush()
    assert bag.disk.fault is None
    assert bag.disk.backlog == bag.lost == 0
    bag.close()
    assert numbers(bag.path) == list(range(1, 3001))
    assert missing_parts(bag.path) == ""


# The space is used up by a chunk, within one, within the index, and in the second file of several.
@pytest.mark.parametrize("settings", [{}, {"max_file_size": 1_000_000}, {"compression": "lz4"}])
@pytest.mark.parametrize("size", [100, 300, 5_000, 280_000, 527_200, 785_000, 790_000])
def test_closed_on_a_full_disk_it_keeps_what_the_disk_took(tmp_path, size, settings):
    bag = Bag(tmp_path / "bag", **settings)
    bag.attach("parameters.yaml", "seed: 3", 1)
    bag.fill(1)
    bag.flush()
    sentence = ""
    with limited(size):
        bag.fill(2999)
        start = time.monotonic()
        try:
            bag.close()
        except UnfinishedBagError as error:
            sentence = str(error)
        assert time.monotonic() - start < 3.0  # 2 s, where the machine is quiet
    assert bool(missing_parts(bag.path)) == bool(sentence)
    if sentence:
        assert re.search("ulimit -f.*bag reindex", sentence)
        reindex(bag.path)
    assert numbers(bag.path) == list(range(1, bag.message_count + 1))
    assert bag.message_count + bag.lost == 3000
    with BagReader(bag.path) as reader:
        assert reader.attachments() == {"parameters.yaml": "seed: 3"}


@pytest.fixture
def gate(monkeypatch):
    """A disk that takes nothing until the gate is opened."""
    gate, write = threading.Event(), os.pwrite

    def slow(*arguments) -> int:
        gate.wait()
        return write(*arguments)

    monkeypatch.setattr(os, "pwrite", slow)
    gate.set()
    yield gate
    gate.set()


def test_a_slow_disk_holds_nothing_up_and_what_is_too_much_is_counted(tmp_path, gate):
    bag = Bag(tmp_path / "bag", max_backlog=5_000_000)
    bag.flush()
    gate.clear()
    bag.fill(10_000)  # would not return if it waited
    bag.flush(wait=False)
    assert 5_000_000 < bag.disk.backlog < 6_000_000
    assert 4_000 < bag.lost < 5_500
    assert bag.disk.fault is None
    gate.set()
    bag.flush()
    kept = bag.message_count
    bag.fill(1)
    bag.close()
    assert numbers(bag.path) == [*range(1, kept + 1), 10_001]
    assert kept + bag.lost == 10_000


def test_the_end_waits_for_a_slow_disk_unless_it_is_hurried(tmp_path, monkeypatch):
    write, filled = os.pwrite, threading.Event()

    def slow(*arguments) -> int:
        filled.wait()  # however long a busy machine takes to fill the bags
        time.sleep(0.2)
        return write(*arguments)

    monkeypatch.setattr(os, "pwrite", slow)
    patient, hurried = Bag(tmp_path / "patient"), Bag(tmp_path / "hurried")
    for bag in (patient, hurried):
        bag.fill(4000)
    filled.set()
    start = time.monotonic()
    with suppress(UnfinishedBagError):  # where the end of the file comes too late as well
        hurried.close(lambda: True)
    assert time.monotonic() - start < 3.0  # 2 s, where the machine is quiet
    assert hurried.lost > 0
    patient.close()
    assert patient.lost == 0
    assert numbers(patient.path) == list(range(1, 4001))


def test_the_end_does_not_wait_for_a_disk_that_hangs(tmp_path, gate):
    bag = Bag(tmp_path / "bag")
    bag.fill(500)
    bag.flush()
    gate.clear()
    bag.fill(500)
    start = time.monotonic()
    with pytest.raises(UnfinishedBagError, match="hangs"):
        bag.close()
    assert time.monotonic() - start < 3.0  # 2 s, where the machine is quiet
    assert (bag.message_count, bag.lost) == (500, 500)
    gate.set()
    deadline = time.monotonic() + 10.0
    while "still being recorded" in missing_parts(bag.path) and time.monotonic() < deadline:
        time.sleep(0.02)  # until the write that hung has ended
    assert re.search(r"bag_0\.mcap. [0-9]+ messages", missing_parts(bag.path))
    reindex(bag.path)
    kept = numbers(bag.path)
    assert kept == list(range(1, len(kept) + 1))
    assert len(kept) >= 500  # the write that hung may have come through


def test_some_space_is_kept_for_the_end_of_the_bag(tmp_path):
    space = os.statvfs(tmp_path)
    free = space.f_bavail * space.f_frsize
    with pytest.raises(InvalidInputError, match="cannot be written to: No space left but"):
        BagWriter(tmp_path / "bag", min_space=free + 10**9)
    assert not (tmp_path / "bag").exists()


def test_a_bag_whose_metadata_cannot_be_written_says_so(tmp_path):
    bag = Bag(tmp_path / "bag")
    bag.fill(10)
    (bag.path / "metadata.yaml").mkdir()
    with pytest.raises(UnfinishedBagError, match=r"metadata\.yaml cannot be written, Is"):
        bag.close()
    (bag.path / "metadata.yaml").rmdir()
    assert [file.name for file in bag.path.iterdir()] == ["bag_0.mcap"]
    reindex(bag.path)
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
        reindex(killed)
    assert {f.name: f.read_bytes() for f in killed.iterdir()} == {"bag_0.mcap": before}
    reindex(killed)
    assert numbers(killed) == list(range(1, 501))


FILLS_A_DISK = """
import errno, sys
from pathlib import Path
from tests.storage.test_disk import Bag, numbers
from vgps_ros.bags.reindex import missing_parts
folder = Path(sys.argv[1])
bag = Bag(folder / "bag", min_space=int(sys.argv[2]))
bag.fill(1000)
bag.flush()
filler = folder / "filler"
with filler.open("wb", buffering=0) as file:
    try:
        while file.write(bytes(4096)):
            pass
    except OSError:
        pass
bag.fill(1000)
bag.flush()
assert bag.disk.fault.number == errno.ENOSPC and "free some space" in bag.disk.fault.next_step
filler.unlink()
bag.flush()
assert bag.disk.fault is None and bag.lost == 0
bag.fill(100_000)
bag.close()
assert missing_parts(bag.path) == "", missing_parts(bag.path)
assert numbers(bag.path) == list(range(1, bag.message_count + 1))
assert bag.lost > 90_000 and bag.message_count + bag.lost == 102_000
print(bag.message_count)
"""


def test_on_a_real_disk_that_is_full_it_goes_on_when_there_is_space_and_ends_whole(tmp_path):
    mount = 'mount -t tmpfs -o size=4m none "$0" && exec "$@"'  # unmounted with its namespace
    namespace = ["unshare", "-rm", "sh", "-c", mount, str(tmp_path)]
    if subprocess.run([*namespace, "true"], capture_output=True, check=False).returncode:
        pytest.skip("Needs namespaces, to mount a small disk; the tests above do without.")
    run = subprocess.run(
        [*namespace, sys.executable, "-c", FILLS_A_DISK, str(tmp_path), "200000"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert 3000 < int(run.stdout) < 4000
    assert list(tmp_path.iterdir()) == []
