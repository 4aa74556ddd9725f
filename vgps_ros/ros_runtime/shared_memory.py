"""Which shared memory of Fast DDS is whose; a process that does not close it leaves it behind."""

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
    """What an open file is; nothing if it was closed meanwhile, as the listing itself."""
    with suppress(FileNotFoundError):
        return os.readlink(link)
    return ""
