# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The files of Fast DDS's shared memory, which a process that is cut off leaves behind.

Fast DDS has no public call that lists or removes a process's segments: `fastdds shm clean` removes
only what no process has open. tests/nodes/test_private_names.py guards the files' names.
"""

import os
import re
from contextlib import suppress
from pathlib import Path


def owned_segments(pid: int) -> set[Path]:
    """Returns the segments that are a process's own: it holds a lock file open for each.

    The ports on which it listens are among them.
    """
    files = Path(f"/proc/{pid}/fd")
    try:
        opened = map(_target, files.iterdir())
        locks = [file for file in opened if re.fullmatch("/dev/shm/fastrtps_.*_el", file)]
    except OSError:  # it has ended meanwhile, or belongs to somebody else
        return set()
    return {Path(lock.removesuffix("_el")) for lock in locks}


def is_port(segment: Path) -> bool:
    """Returns whether it is a port: small, and the next process in that place takes its name."""
    return segment.name.startswith("fastrtps_port")


def files_of(segment: Path) -> list[Path]:
    """Returns the files that a segment consists of: memory, lock, semaphore."""
    names = segment.name, f"{segment.name}_el", f"sem.{segment.name}_mutex"
    return [segment.with_name(name) for name in names]


def _target(link: Path) -> str:
    """Returns the path of an open file; empty if it was closed in the meantime."""
    with suppress(FileNotFoundError):
        return os.readlink(link)
    return ""
