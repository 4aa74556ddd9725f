"""A Rerun recording that is written to a file; no screen, and no port."""

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
from vgps_ros.storage.disk import Disk, DiskFault, DiskFile

TIME = "ros2_timestamp"  # stamps of messages, as Rerun's own MCAP reader names it
WALL_TIME = "wall_time"  # stamps of what does not belong to the robot's time
ITERATION = "iteration"  # of Algorithm 1

# Each piece of an entity's data costs memory until the file is complete, and room in it.
_PERIOD = 5.0  # of pieces [s]
_BATCHES = rr.ChunkBatcherConfig(flush_tick=_PERIOD)

_PIECE = 2**18  # that is written at once [bytes]
_PATIENCE = 0.8  # with a disk that does not move, at the end [s]


class UnfinishedRecordingError(VgpsError):
    """The disk did not take the end of a recording; what is there can be read."""


class Recording:
    """A file that is being written; a slow or full disk is waited for in the background.

    Args:
        path: the file; it must not exist.

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
        self._disk = Disk()
        self._file = DiskFile(self._disk, path)
        self._stream = rr.RecordingStream("vgps_ros", batcher_config=_BATCHES)
        # Rerun gives up a file at the first error, and then may never end: it writes to a pipe.
        source, sink = os.pipe()
        self._stream.save(f"/proc/self/fd/{sink}")
        os.close(sink)
        self._flushed = time.monotonic()
        self._pump = threading.Thread(target=self._take, args=[source], name="pump", daemon=True)
        self._pump.start()

    @property
    def fault(self) -> DiskFault | None:
        """Why nothing can be written now."""
        return self._disk.fault

    @property
    def backlog(self) -> int:
        """What waits for the disk [bytes]."""
        return self._disk.backlog

    def log(self, entity: str, *what: Any) -> None:
        """Shows something at the time that was set last."""
        self._stream.log(entity, *what)
        # Rerun's own tick comes only where nothing is logged for as long. Without it a row of a
        # quiet entity waits among busy ones, and keeps the whole page of memory in which it lies.
        if time.monotonic() - self._flushed > _PERIOD:
            self._stream.flush(timeout_sec=0.0)  # begins it, and does not wait
            self._flushed = time.monotonic()

    def log_static(self, entity: str, *what: Any) -> None:
        """Shows something at all times."""
        self._stream.log(entity, *what, static=True)

    def name_series(self, entity: str, names: Sequence[str]) -> None:
        """Names the components of the numbers that an entity shows."""
        self.log_static(entity, rr.SeriesLines(names=list(names)))

    def set_time(self, stamp: int) -> None:
        """Sets the robot's time [ns] of what follows."""
        self._stream.reset_time()
        self._stream.set_time(TIME, timestamp=np.datetime64(stamp, "ns"))

    def set_iteration(self, iteration: int, stamp: int) -> None:
        """Sets the iteration of Algorithm 1 and the wall-clock time [ns] of what follows."""
        self._stream.reset_time()
        self._stream.set_time(ITERATION, sequence=iteration)
        self._stream.set_time(WALL_TIME, timestamp=np.datetime64(stamp, "ns"))

    def send_series(self, entity: str, stamps: np.ndarray, values: np.ndarray) -> None:
        """Shows numbers, shape (N, M), at the robot's times, shape (N,) [ns]."""
        times = rr.TimeColumn(TIME, timestamp=stamps.astype("datetime64[ns]"))
        columns = rr.Scalars.columns(scalars=values).partition([values.shape[1]] * len(values))
        self._stream.send_columns(entity, [times], columns)

    def send_by_iteration(self, entity: str, iterations: np.ndarray, values: np.ndarray) -> None:
        """Shows a number, shape (N,), at iterations of a search, shape (N,)."""
        times = rr.TimeColumn(ITERATION, sequence=iterations)
        self._stream.send_columns(entity, [times], rr.Scalars.columns(scalars=values))

    def lay_out(self, blueprint: rrb.Blueprint) -> None:
        """Says what a viewer shows where, when it opens the file."""
        self._stream.send_blueprint(blueprint)

    def close(self, hurried: Callable[[], bool] = lambda: False) -> None:
        """Completes the file.

        Args:
            hurried: whether not to wait for more than a moment, even if the disk is but slow.

        Raises:
            UnfinishedRecordingError: the disk is full, or hangs.
        """
        self._stream.flush()
        self._stream.disconnect()
        self._pump.join()
        is_whole, fault = self._disk.drain(_PATIENCE, hurried), self._disk.fault
        self._disk.stop()
        if not is_whole:
            reason = f"{fault.reason}; {fault.next_step}" if fault else "the disk hangs"
            raise UnfinishedRecordingError(
                f"The recording '{self._file.path}' lacks its end: {reason}."
            )

    def _take(self, source: int) -> None:
        with open(source, "rb", buffering=0) as pipe:
            while piece := pipe.read(_PIECE):
                self._file.write(piece)
        self._file.close()
