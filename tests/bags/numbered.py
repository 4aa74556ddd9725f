# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Bags of numbered messages, and disks on which they do not go well."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from vgps_ros.bags import BagWriter

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
