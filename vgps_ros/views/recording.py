"""A Rerun recording that is written to a file; no screen, and no port."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vgps_ros.core.errors import InvalidInputError

TIME = "ros2_timestamp"  # stamps of messages, as Rerun's own MCAP reader names it
WALL_TIME = "wall_time"  # stamps of what does not belong to the robot's time
ITERATION = "iteration"  # of Algorithm 1


class Recording:
    """A file that is being written.

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
        self._stream = rr.RecordingStream("vgps_ros")
        self._stream.save(path)

    def log(self, entity: str, *what: Any) -> None:
        """Shows something at the time that was set last."""
        self._stream.log(entity, *what)

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

    def close(self) -> None:
        """Completes the file."""
        self._stream.flush()
        self._stream.disconnect()
