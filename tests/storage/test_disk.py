# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A slow, full or hanging disk: nobody waits for it, and what it took can be read."""

import hashlib
import os
import subprocess
import sys
import time
from errno import EFBIG
from pathlib import Path

import pytest

from tests.bags.numbered import Bag, limited, numbers
from vgps_ros.bags import BagWriter
from vgps_ros.bags.reader import missing_parts
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.disk import Disk


def test_when_there_is_space_again_it_goes_on_and_nothing_is_lost(tmp_path):
    bag = Bag(tmp_path / "bag")
    with limited(1_000_000):
        bag.fill(2000)
        bag.flush()
        assert bag.disk.fault.number == EFBIG
        assert bag.disk.fault.path.name == "bag_0.mcap"
        assert "MB are free there" in bag.disk.fault.reason
        assert "ulimit -f" in bag.disk.fault.next_step
        assert bag.disk.backlog > 900_000
    bag.fill(1000)
    bag.flush()
    assert bag.disk.fault is None
    assert bag.disk.backlog == bag.lost == 0
    bag.close()
    assert numbers(bag.path) == list(range(1, 3001))
    assert missing_parts(bag.path) == ""


def test_a_hanging_disk_is_given_up_after_a_while_and_what_waits_can_be_taken_back(tmp_path, gate):
    disk = Disk()
    file = disk.open(tmp_path / "file")
    disk.put(file.write, b"first", size=5)
    assert disk.drain()
    gate.clear()
    disk.put(file.write, b" and second", size=11)
    time.sleep(0.2)  # until it is under way
    disk.put(file.write, b" and third", size=10)
    assert not disk.drain()
    assert (file.tell(), disk.backlog) == (5, 21)
    assert disk.abandon() == [(file.write, (b" and third",), 10)]
    assert disk.backlog == 11
    gate.set()
    disk.put(file.close)
    assert disk.drain()
    assert disk.backlog == 0
    assert disk.stop()
    assert file.path.read_bytes() == b"first and second"
    assert file.sha256.hexdigest() == hashlib.sha256(b"first and second").hexdigest()


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
from vgps_ros.bags.reader import missing_parts
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
