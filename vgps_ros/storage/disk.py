# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files written in a thread of their own, so that a slow or full disk holds up nobody.

A block that cannot be written is tried again until it can be, so a full disk only delays it.
"""

import fcntl
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from errno import EDQUOT, EFBIG, ENOSPC
from pathlib import Path

_RETRY_PERIOD = 0.5  # between two attempts at what failed [s]
_HURRY = 0.5  # what is left to a disk whose user wants the end [s]
_MOMENT = 0.1  # for the thread to end, if it does not hang [s]

_NEXT_STEPS = {
    ENOSPC: "free some space there",
    EDQUOT: "free some space there, or raise the quota",
    EFBIG: "files may not grow that large there: raise `ulimit -f`, or record into smaller ones",
}


@dataclass(frozen=True)
class DiskFault:
    """The reason why nothing can be written now.

    Attributes:
        number: the system's error number.
        path: the file that could not be written.
        reason: what the system says, and the space that is free.
        next_step: what to do.
    """

    number: int
    path: Path
    reason: str
    next_step: str

    @property
    def sentence(self) -> str:
        """The fault as a sentence for the user, while the recording goes on."""
        return (
            f"Cannot write to '{self.path}': {self.reason}. Recording waits and goes on by itself; "
            f"{self.next_step}."
        )


class DiskFile:
    """A file; what is handed over in one call is on the disk as a whole, or not at all.

    Attributes:
        path: the file, which is made with the first block, unless it is there.
        written: bytes on the disk.
        is_closed: whether all is on the disk and nothing more can be.
    """

    def __init__(self, disk: "Disk", path: Path):
        self.path = path
        self.written = 0
        self.is_closed = False
        self._disk = disk
        self._position = 0
        self._descriptor = -1

    def write(self, block: bytes) -> int:
        """Hands a block over."""
        if block:
            self._position += len(block)
            self._disk.put(self, block)
        return len(block)

    def tell(self) -> int:
        """Returns the bytes handed over."""
        return self._position

    def flush(self) -> None:
        """Does nothing: each block is on its way already."""

    def close(self) -> None:
        """Ends the file after what was handed over."""
        self._disk.put(self, None)

    def cut(self, position: int) -> None:
        """Goes back to a position; only while nothing waits for the disk."""
        if self._descriptor >= 0:
            with suppress(OSError):
                os.ftruncate(self._descriptor, position)
        self.written = self._position = position

    def append(self, block: bytes, min_space: int) -> None:
        """Writes a block; for the thread alone.

        Raises:
            OSError: it could not be written; nothing of it is left.
        """
        if self._descriptor < 0:
            flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC
            self._descriptor = os.open(self.path, flags, 0o666)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX)  # see is_being_written
        if min_space:
            space = os.fstatvfs(self._descriptor)
            if space.f_bavail * space.f_frsize < min_space + len(block):
                raise OSError(ENOSPC, f"No space left but {min_space * 1e-6:g} MB, which are kept")
        rest, position = memoryview(block), self.written
        try:
            while rest:
                count = os.pwrite(self._descriptor, rest, position)
                rest, position = rest[count:], position + count
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self.written)
            raise
        self.written = position

    def release(self) -> None:
        """Closes the file; for the thread alone."""
        self.is_closed = True
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


class Disk:
    """The thread that appends blocks to files, in the order in which they were handed over.

    Args:
        min_space: do not use the last bytes that are free on the disk.

    Attributes:
        min_space: as above; may be changed.
        backlog: bytes that wait.
        fault: why the first of them cannot be written now; None if it can.
    """

    def __init__(self, min_space: int = 0):
        self.min_space = min_space
        self.backlog = 0
        self.fault: DiskFault | None = None
        self._blocks: deque[tuple[DiskFile, bytes | None]] = deque()
        self._changed = threading.Condition()
        self._failures = 0
        self._is_busy = False
        self._is_stopped = False
        # A daemon: the end of the process must not wait for a disk that hangs.
        self._thread = threading.Thread(target=self._run, name="disk", daemon=True)
        self._thread.start()

    def put(self, file: DiskFile, block: bytes | None) -> None:
        """Hands over a block, or None to close the file."""
        with self._changed:
            self._blocks.append((file, block))
            self.backlog += len(block or b"")
            self._changed.notify_all()

    def drain(
        self, patience: float = float("inf"), hurried: Callable[[], bool] = lambda: False
    ) -> bool:
        """Waits until all is written, an attempt fails, or nothing moves any more.

        Args:
            patience: how long nothing may move [s].
            hurried: whether to leave it at what can be done in a moment.

        Returns:
            Whether all is written.
        """
        with self._changed:
            failed, left, end = self._failures, -1, float("inf")
            self._changed.notify_all()  # try now, if an attempt failed a moment ago
            while self._blocks and self._failures == failed:
                now = time.monotonic()
                if len(self._blocks) != left:
                    left, stalled = len(self._blocks), now + patience
                if hurried():
                    end = min(end, now + _HURRY)
                if now > min(stalled, end):
                    break
                self._changed.wait(0.02)
            return not self._blocks

    def abandon(self) -> bool:
        """Forgets what waits; returns whether nothing hangs, so that files can be cut."""
        with self._changed:
            self._blocks.clear()
            self.backlog = 0
            self._changed.notify_all()
            return self._changed.wait_for(lambda: not self._is_busy, timeout=_HURRY)

    def stop(self) -> None:
        """Forgets what waits, closes all files and ends the thread, unless it hangs."""
        with self._changed:
            self._blocks.clear()
            self._is_stopped = True
            self._changed.notify_all()
        self._thread.join(_MOMENT)

    def _run(self) -> None:
        files: set[DiskFile] = set()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._blocks or self._is_stopped)
                if not self._blocks:
                    break
                first = file, block = self._blocks[0]
                self._is_busy = True
            files.add(file)
            fault = None
            try:
                if block is None:
                    files.discard(file)
                    file.release()
                else:
                    file.append(block, self.min_space)
            except OSError as error:
                fault = _fault(file.path, error)
            with self._changed:
                self._is_busy = False
                # The sentence of a fault does not change while the fault lasts.
                if not (fault and self.fault and fault.number == self.fault.number):
                    self.fault = fault
                self._failures += fault is not None
                if not fault and self._blocks and self._blocks[0] is first:
                    self._blocks.popleft()
                    self.backlog -= len(block or b"")
                self._changed.notify_all()
                if fault and self._blocks:
                    self._changed.wait(_RETRY_PERIOD)
        for file in files:
            with suppress(OSError):
                file.release()


def _fault(path: Path, error: OSError) -> DiskFault:
    return DiskFault(
        error.errno or 0,
        path,
        f"{error.strerror}, {_free_space(path)}",
        _NEXT_STEPS.get(error.errno or 0, "check the disk"),
    )


def _free_space(path: Path) -> str:
    try:
        space = os.statvfs(path.parent)
    except OSError as error:
        return f"free space unknown ({error.strerror})"
    return f"{space.f_bavail * space.f_frsize * 1e-6:.1f} MB are free there"
