# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a Rerun recording to a file, without a screen and without opening a port."""

import os
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.storage.disk import Disk, DiskFile

TIME = "time"  # timeline of message stamps as the robot's time, which begins at 0 s
STAMP = "ros2_timestamp"  # the same as dates, named as in Rerun's own MCAP reader
WALL_TIME = "wall_time"  # timeline of the stamps that are not in the robot's time
ITERATION = "iteration"  # timeline of the iterations of Algorithm 1

# Rerun writes the data of each entity in pieces. Each piece takes room in the file, and memory
# until the file is complete, so pieces should be large.
_PERIOD = 5.0  # time between two pieces of an entity [s]
_BATCHES = rr.ChunkBatcherConfig(flush_tick=_PERIOD)

_PIECE = 2**18  # largest number of bytes that is written to the disk at once
_PATIENCE = 0.8  # how long to wait at the end for a disk that takes nothing [s]


class UnfinishedRecordingError(VgpsError):
    """Raised when a recording lacks its end. The part on the disk can be read."""


class Recording:
    """A recording that is being written. A thread waits for the disk where it is slow or full.

    Args:
        path: the file, which must not exist yet.

    Attributes:
        disk: the disk, which says what waits for it and why nothing can be written now.
        logged: the entities to which something was logged.

    Raises:
        InvalidInputError: the file exists, or cannot be written.
    """

    def __init__(self, path: Path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch(exist_ok=False)
        except FileExistsError as error:
            raise InvalidInputError(
                f"The recording '{path}' exists already; name another file."
            ) from error
        except OSError as error:
            raise InvalidInputError(
                f"The recording '{path}' cannot be written: {error}."
            ) from error
        self.disk = Disk()
        self.logged: set[str] = set()
        self._file = DiskFile(self.disk, path)
        self._stream = rr.RecordingStream("vgps_ros", batcher_config=_BATCHES)
        # Rerun gives up a file at its first error and may then hang at the end, so it writes to a
        # pipe, from which our thread writes to the disk.
        source, sink = os.pipe()
        self._stream.save(f"/proc/self/fd/{sink}")
        os.close(sink)
        self._flushed = time.monotonic()
        self._pump = threading.Thread(target=self._take, args=[source], name="pump", daemon=True)
        self._pump.start()

    def log(self, entity: str, *what: Any) -> None:
        """Adds components to an entity at the time that was set last."""
        self.logged.add(entity)
        self._stream.log(entity, *what)
        # Rerun flushes by itself only when nothing was logged for a while. Otherwise a row of a
        # quiet entity would wait among the rows of busy ones and keep their memory in use.
        if time.monotonic() - self._flushed > _PERIOD:
            self._stream.flush(timeout_sec=0.0)  # starts the flush without waiting for its end
            self._flushed = time.monotonic()

    def log_static(self, entity: str, *what: Any) -> None:
        """Adds components to an entity that hold at all times."""
        self.logged.add(entity)
        self._stream.log(entity, *what, static=True)

    def name_series(self, entity: str, names: Sequence[str], **style: Any) -> None:
        """Names the series of numbers that an entity shows; `style` is that of their lines."""
        self.log_static(entity, rr.SeriesLines(names=list(names), **style))

    def set_time(self, stamp: int) -> None:
        """Sets the robot's time [ns] for the calls of `log` that follow."""
        self._stream.reset_time()
        self._stream.set_time(TIME, duration=np.timedelta64(stamp, "ns"))
        self._stream.set_time(STAMP, timestamp=np.datetime64(stamp, "ns"))

    def set_iteration(self, iteration: int, stamp: int) -> None:
        """Sets the iteration and the wall-clock time [ns] for the calls of `log` that follow."""
        self._stream.reset_time()
        self._stream.set_time(ITERATION, sequence=iteration)
        self._stream.set_time(WALL_TIME, timestamp=np.datetime64(stamp, "ns"))

    def send_series(self, entity: str, times: Sequence[rr.TimeColumn], values: np.ndarray) -> None:
        """Adds values, shape (N, M), at N times or iterations, of one timeline or of several."""
        columns = rr.Scalars.columns(scalars=values).partition([values.shape[1]] * len(values))
        self._stream.send_columns(entity, times, columns)

    @staticmethod
    def time_columns(stamps: np.ndarray) -> list[rr.TimeColumn]:
        """Returns the columns of the robot's times [ns], shape (N,), for `send_series`."""
        return [
            rr.TimeColumn(TIME, duration=stamps.astype("timedelta64[ns]")),
            rr.TimeColumn(STAMP, timestamp=stamps.astype("datetime64[ns]")),
        ]

    def lay_out(self, blueprint: rrb.Blueprint) -> None:
        """Sets the layout in which a viewer shows the file."""
        self._stream.send_blueprint(blueprint)

    def close(self, hurried: Callable[[], bool] = lambda: False) -> None:
        """Completes the file.

        Args:
            hurried: returns True once the caller cannot wait any longer for a slow disk.

        Raises:
            UnfinishedRecordingError: the disk is full or does not respond.
        """
        self._stream.flush()
        self._stream.disconnect()
        self._pump.join()
        is_whole, fault = self.disk.drain(_PATIENCE, hurried), self.disk.fault
        self.disk.stop()
        if not is_whole:
            reason = f"{fault.reason}; {fault.next_step}" if fault else "the disk does not respond"
            raise UnfinishedRecordingError(
                f"The recording '{self._file.path}' lacks its end: {reason}."
            )

    def _take(self, source: int) -> None:
        """Writes to the disk what Rerun writes to the pipe."""
        with open(source, "rb", buffering=0) as pipe:
            while piece := pipe.read(_PIECE):
                self._file.write(piece)
        self._file.close()
