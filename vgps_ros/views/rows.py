# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Gathers what an entity shows at many times into the columns that Rerun stores."""

from collections import defaultdict
from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike

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


class Rows:
    """Rows of one entity, each with the time at which it shows.

    Where Rerun gets each row by itself, it makes a small Arrow array of each component, and the
    memory of these is not used again: a visualizer of a busy graph grew by 2 MB a minute. Here the
    numbers of each component are in one buffer, since small arrays leave holes in the memory, too.

    Args:
        kind: the archetype, such as `rr.Scalars`.
        timeline: makes the columns of the times.
    """

    def __init__(self, kind: Any, timeline: Timeline):
        self._kind, self._timeline = kind, timeline
        self._times: list[int | tuple[int, int]] = []
        self._numbers: dict[str, bytearray] = defaultdict(bytearray)
        self._shapes: dict[str, list[tuple[int, ...]]] = defaultdict(list)

    def __len__(self) -> int:
        return len(self._times)

    def add(self, time: int | tuple[int, int], values: dict[str, ArrayLike]) -> None:
        """Adds a row: a copy of the values of each component, one for each instance."""
        self._times.append(time)
        for name, value in values.items():
            numbers = np.asarray(value, float)
            self._numbers[name] += numbers.tobytes()
            self._shapes[name].append(numbers.shape)

    def columns(self) -> tuple[list[rr.TimeColumn], rr.ComponentColumnList]:
        """Returns the columns of the times and of the components."""
        components = {name: self._instances(name) for name in self._numbers}
        lengths = [shape[0] for shape in next(iter(self._shapes.values()))]
        columns = self._kind.columns(**components).partition(lengths)
        return self._timeline(np.array(self._times)), columns

    def _instances(self, name: str) -> list[Array]:
        """Returns the values of a component, those of all rows one after another."""
        numbers, instances, begin = np.frombuffer(self._numbers[name]), list[Array](), 0
        for shape in self._shapes[name]:
            end = begin + prod(shape)
            instances.extend(numbers[begin:end].reshape(shape))
            begin = end
        return instances
