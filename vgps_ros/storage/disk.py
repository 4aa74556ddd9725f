# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files that are written in a thread, so that a slow or full disk holds up nobody else.

A block that cannot be written is tried again until it can be, so a full disk only delays it.
"""

import fcntl
import hashlib
import os
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from errno import EDQUOT, EFBIG, ENOSPC
from pathlib import Path

_PERIOD = 0.05  # between two looks for new work [s]
_RETRY_PERIOD = 0.5  # between two attempts to write a block [s]
_PATIENCE = 0.8  # how long to wait at the end for a disk that takes nothing [s]
_MOMENT = 0.5  # for the thread to end, if the disk does not hang [s]

_NEXT_STEPS = {
    ENOSPC: "free some space there",
    EDQUOT: "free some space there, or raise the quota",
    EFBIG: "files may not grow that large there: raise `ulimit -f`, or record into smaller ones",
}

_Work = tuple[Callable[..., object], tuple[object, ...], int]  # with the bytes that it keeps


@dataclass(frozen=True)
class DiskFault:
    """The reason why nothing can be written now."""

    number: int  # of the system's error
    path: Path  # the file that could not be written
    reason: str  # what the system says, and the space that is free
    next_step: str  # what to do

    @property
    def sentence(self) -> str:
        """The fault as a sentence for the user, while the recording goes on."""
        return (
            f"Cannot write to '{self.path}': {self.reason}. Recording waits and goes on by itself; "
            f"{self.next_step}."
        )


class Disk:
    """A thread that does work on files, in the order in which it was handed over.

    Args:
        min_space: bytes to leave free on the disk; may be changed.
        idle: called in the thread about every 50 ms.

    Attributes:
        fault: why nothing can be written now; None if it can.
    """

    def __init__(self, min_space: int = 0, idle: Callable[[], object] = lambda: None):
        self.min_space = min_space
        self.fault: DiskFault | None = None
        self._idle = idle
        self._work: deque[_Work] = deque()
        self._files: list[DiskFile] = []
        self._is_busy = False
        self._taking = threading.Lock()
        self._given, self._done = 0, 0  # bytes, each counted by one thread
        self._wake, self._given_up = threading.Event(), threading.Event()
        # A daemon: the end of the process must not wait for a disk that hangs.
        self._thread = threading.Thread(target=self._run, name="disk", daemon=True)
        self._thread.start()

    @property
    def backlog(self) -> int:
        """Bytes that wait in memory."""
        return self._given - self._done

    def open(self, path: Path) -> "DiskFile":
        """Returns a file that is closed at the latest when the thread ends."""
        file = DiskFile(self, path)
        self._files.append(file)
        return file

    def put(self, work: Callable[..., object], *arguments: object, size: int = 0) -> None:
        """Hands work over: a function, and arguments that keep so many bytes in memory."""
        self._given += size
        self._work.append((work, arguments, size))

    def drain(self) -> bool:
        """Waits until all work is done; returns False if nothing moved for a while."""
        self._wake.set()
        left, stalled = -1, 0.0
        while count := len(self._work) + self._is_busy:
            if count != left:
                left, stalled = count, time.monotonic() + _PATIENCE
            if time.monotonic() > stalled:
                return False
            time.sleep(0.005)
        return True

    def abandon(self) -> list[_Work]:
        """Returns all work but what is under way, which the thread then no longer does."""
        with self._taking:
            forgotten = list(self._work)
            self._work.clear()
        self._given -= sum(size for _, _, size in forgotten)
        return forgotten

    def stop(self) -> bool:
        """Gives up what could not be done; returns False if the disk does not respond."""
        self._given_up.set()
        self._wake.set()
        self._thread.join(_MOMENT)
        return not self._thread.is_alive()

    def wait(self, path: Path, error: OSError) -> None:
        """Waits until a file should be tried again; raises the error once `stop` was called."""
        # The sentence of a fault does not change while the fault lasts.
        if not self.fault or self.fault.number != error.errno:
            self.fault = _fault(path, error)
        if self._given_up.wait(_RETRY_PERIOD):
            raise error

    def _run(self) -> None:
        try:
            while not self._given_up.is_set():
                self._wake.wait(_PERIOD)
                self._wake.clear()
                while self._take():
                    pass
                self._idle()
        except OSError:
            self.abandon()  # given up
        finally:
            for file in self._files:
                file.close()

    def _take(self) -> bool:
        with self._taking:
            if not self._work or self._given_up.is_set():
                return False
            self._is_busy = True
            work, arguments, size = self._work.popleft()
        try:
            work(*arguments)
        finally:
            self._is_busy = False
            self._done += size
        return True


class DiskFile:
    """A file that the thread of a `Disk` writes; of each block all is on the disk, or nothing.

    `Disk.open` makes it.

    Attributes:
        path: the file, which is made with the first block, unless it is there.
        size: bytes on the disk.
        sha256: digest of what is on the disk.
    """

    def __init__(self, disk: Disk, path: Path):
        self.path = path
        self.size = 0
        self.sha256 = hashlib.sha256()
        self._disk = disk
        self._descriptor = -1

    def write(self, block: bytes) -> int:
        """Appends a block, however long that takes.

        Raises:
            OSError: it could not be written until the disk was stopped.
        """
        while block:
            try:
                self._append(block)
            except OSError as error:  # noqa: PERF203
                self._disk.wait(self.path, error)
            else:
                self._disk.fault = None
                self.size += len(block)
                self.sha256.update(block)
                break
        return len(block)

    def tell(self) -> int:
        """Returns the size of the file [bytes]."""
        return self.size

    def flush(self) -> None:
        """Does nothing: each block is on the disk already."""

    def close(self) -> None:
        """Closes the file."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1

    def _append(self, block: bytes) -> None:
        if self._descriptor < 0:
            flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC
            self._descriptor = os.open(self.path, flags, 0o666)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX)  # see `is_being_written`
        if kept := self._disk.min_space:
            space = os.fstatvfs(self._descriptor)
            if space.f_bavail * space.f_frsize < kept + len(block):
                raise OSError(ENOSPC, f"No space left but {kept * 1e-6:g} MB, which are kept")
        rest, position = memoryview(block), self.size
        try:
            while rest:
                count = os.pwrite(self._descriptor, rest, position)
                rest, position = rest[count:], position + count
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self.size)
            raise


def is_being_written(path: Path) -> bool:
    """Returns whether a `DiskFile` of some process still writes the file."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _fault(path: Path, error: OSError) -> DiskFault:
    number, reason = error.errno or 0, str(error.strerror)
    with suppress(OSError):
        reason += f", {shutil.disk_usage(path.parent).free * 1e-6:.1f} MB are free there"
    return DiskFault(number, path, reason, _NEXT_STEPS.get(number, "check the disk"))
