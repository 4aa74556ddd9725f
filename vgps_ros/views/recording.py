# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a Rerun recording to a file, without a screen and without opening a port."""

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike

from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.records import Array

TIME = "time"  # timeline of message stamps as the robot's time, which begins at 0 s
STAMP = "ros2_timestamp"  # the same as dates, named as in Rerun's own MCAP reader
WALL_TIME = "wall_time"  # timeline of the stamps that are not in the robot's time
ITERATION = "iteration"  # timeline of the iterations of Algorithm 1

Timeline = Callable[[np.ndarray], list[rr.TimeColumn]]


def robot_time(stamps: np.ndarray) -> list[rr.TimeColumn]:
    """Returns the columns of the robot's times [ns], shape (N,)."""
    return [
        rr.TimeColumn(TIME, duration=stamps.astype("timedelta64[ns]")),
        rr.TimeColumn(STAMP, timestamp=stamps.astype("datetime64[ns]")),
    ]


def iterations(pairs: np.ndarray) -> list[rr.TimeColumn]:
    """Returns the columns of iterations and their wall-clock times [ns], shape (N, 2)."""
    return [
        rr.TimeColumn(ITERATION, sequence=pairs[:, 0]),
        rr.TimeColumn(WALL_TIME, timestamp=pairs[:, 1].astype("datetime64[ns]")),
    ]


# The rows of each entity are written in pieces. Each piece takes room in the file, and memory until
# the file is complete, so pieces should be large.
_PERIOD = 5.0  # longest time between two pieces of an entity that has rows [s]
_LONGEST = 2000  # largest number of rows in a piece
_FLUSH_TIMEOUT = 5.0  # for the disk, at the end [s]


class UnfinishedRecordingError(VgpsError):
    """Raised when a recording lacks its end. The part on the disk can be read."""


class _Rows:
    """The rows of one entity that wait to be sent together, which is much faster than each alone.

    Args:
        kind: the archetype, such as `rr.Scalars`.
        timeline: makes the columns of the times.
    """

    def __init__(self, kind: Any, timeline: Timeline):
        self._kind, self._timeline = kind, timeline
        self._times: list[int | tuple[int, int]] = []
        self._values: dict[str, list[Array]] = defaultdict(list)

    def __len__(self) -> int:
        return len(self._times)

    def add(self, time: int | tuple[int, int], values: dict[str, ArrayLike]) -> None:
        """Adds a row: a copy of the values of each component, one for each instance."""
        self._times.append(time)
        for name, value in values.items():
            self._values[name].append(np.array(value, float))

    def columns(self) -> tuple[list[rr.TimeColumn], rr.ComponentColumnList]:
        """Returns the columns of the times and of the components."""
        instances = {name: list(chain(*rows)) for name, rows in self._values.items()}
        lengths = [len(row) for row in next(iter(self._values.values()))]
        columns = self._kind.columns(**instances).partition(lengths)
        return self._timeline(np.array(self._times)), columns


class Recording:
    """A recording that is being written, by a thread of Rerun's.

    Args:
        path: the file, which must not exist yet.

    Attributes:
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
        self.logged: set[str] = set()
        self._path, self._stream = path, rr.RecordingStream("vgps_ros")
        self._rows: dict[tuple[str, Timeline], _Rows] = {}
        self._timeline: Timeline = robot_time
        self._time: int | tuple[int, int] = 0
        self._stream.save(path)
        self._sent = time.monotonic()

    def log(self, entity: str, kind: Any, *, style: Any = None, **values: ArrayLike) -> None:
        """Adds a row to an entity, at the time that was set last.

        Args:
            entity: where it shows.
            kind: the archetype, such as `rr.Scalars`; an entity has one.
            style: components that hold for all rows, such as colours.
            values: the components of this row; the first axis of each counts the instances.
        """
        if style is not None and entity not in self.logged:
            self.log_static(entity, style)
        self.logged.add(entity)
        key = entity, self._timeline
        if (rows := self._rows.get(key)) is None:
            rows = self._rows[key] = _Rows(kind, self._timeline)
        rows.add(self._time, values)
        if len(rows) >= _LONGEST:
            self._send(key)
        self.send_due()

    def send_due(self) -> None:
        """Sends the rows that wait, once some may have waited for `_PERIOD`."""
        if time.monotonic() - self._sent > _PERIOD:
            self._send(*self._rows)
            self._sent = time.monotonic()

    def log_static(self, entity: str, *what: Any) -> None:
        """Adds components to an entity that hold at all times."""
        self.logged.add(entity)
        self._stream.log(entity, *what, static=True)

    def name_series(self, entity: str, names: Sequence[str], **style: Any) -> None:
        """Names the series of numbers that an entity shows; `style` is that of their lines."""
        self.log_static(entity, rr.SeriesLines(names=list(names), **style))

    def set_time(self, stamp: int) -> None:
        """Sets the robot's time [ns] for the calls of `log` that follow."""
        self._timeline, self._time = robot_time, stamp

    def set_iteration(self, iteration: int, stamp: int) -> None:
        """Sets the iteration and the wall-clock time [ns] for the calls of `log` that follow."""
        self._timeline, self._time = iterations, (iteration, stamp)

    def send_series(self, entity: str, times: Sequence[rr.TimeColumn], values: np.ndarray) -> None:
        """Adds values, shape (N, M), at N times or iterations, of one timeline or of several."""
        columns = rr.Scalars.columns(scalars=values).partition([values.shape[1]] * len(values))
        self._stream.send_columns(entity, times, columns)

    def lay_out(self, blueprint: rrb.Blueprint) -> None:
        """Sets the layout in which a viewer shows the file."""
        self._stream.send_blueprint(blueprint)

    def close(self) -> None:
        """Completes the file.

        Raises:
            UnfinishedRecordingError: the disk is full or does not respond.
        """
        self._send(*self._rows)
        try:
            self._stream.flush(timeout_sec=_FLUSH_TIMEOUT)
        except RuntimeError as error:
            raise UnfinishedRecordingError(
                f"The recording '{self._path}' lacks its end ({error}): make room on the disk, and "
                "make it again from the bag (`vgps bag rerun`)."
            ) from error
        finally:
            self._stream.disconnect()

    def _send(self, *keys: tuple[str, Timeline]) -> None:
        for key in keys:
            self._stream.send_columns(key[0], *self._rows.pop(key).columns())
