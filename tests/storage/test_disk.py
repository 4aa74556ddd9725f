# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A slow, full or hanging disk: nobody waits for it, and what it took can be read."""

import os
import subprocess
import sys
from errno import EFBIG
from pathlib import Path

import pytest

from tests.bags.numbered import Bag, limited, numbers
from vgps_ros.bags import BagWriter
from vgps_ros.bags.reindex import missing_parts
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.disk import Disk, DiskFile


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


def test_a_hanging_disk_is_given_up_after_a_while_and_its_file_cut_once_it_moves(tmp_path, gate):
    disk = Disk()
    file = DiskFile(disk, tmp_path / "file")
    file.write(b"first")
    assert disk.drain()
    gate.clear()
    file.write(b"second")
    assert not disk.drain(patience=0.1)
    assert (file.tell(), file.written, disk.backlog) == (11, 5, 6)
    assert not disk.abandon()  # the write hangs, so that nothing may be cut
    gate.set()
    assert disk.abandon()
    assert disk.backlog == 0
    file.cut(5)
    file.write(b" and third")
    file.close()
    assert disk.drain()
    assert file.is_closed
    assert file.path.read_bytes() == b"first and third"
    disk.stop()


def test_a_user_in_a_hurry_waits_only_a_moment_for_a_slow_disk(tmp_path, gate):
    disk = Disk()
    file = DiskFile(disk, tmp_path / "file")
    gate.clear()
    file.write(b"first")
    assert not disk.drain(hurried=lambda: True)
    gate.set()
    assert disk.drain()
    assert file.path.read_bytes() == b"first"
    disk.stop()


def test_some_space_is_kept_for_the_end_of_the_bag(tmp_path):
    space = os.statvfs(tmp_path)
    free = space.f_bavail * space.f_frsize
    with pytest.raises(InvalidInputError, match="cannot be written to: No space left but"):
        BagWriter(tmp_path / "bag", min_space=free + 10**9)
    assert not (tmp_path / "bag").exists()


FILLS_A_DISK = """
import errno, sys
from pathlib import Path
from tests.bags.numbered import Bag, numbers
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
