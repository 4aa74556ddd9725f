# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Conditions on readings, such as that a robot has fallen where its torso is too low."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.records import Array
from vgps_ros.simulation.readings import Readings


@dataclass(frozen=True)
class Conditions:
    """Says whether any reading is outside its range.

    Attributes:
        readings: the r readings.
        lowest: smallest value of each, shape (r,); -inf for none.
        highest: largest value of each, shape (r,); inf for none.
    """

    readings: Readings
    lowest: Array
    highest: Array

    def broken(self, state: Array) -> str:
        """Says which reading of a state (n_x,) is outside its range; empty where none is."""
        if not self.lowest.size:
            return ""
        rows = zip(
            self.readings.names, self.readings(state), self.lowest, self.highest, strict=True
        )
        return next(
            (
                f"{name} is {value:.3g}, but the task allows {low:g} to {high:g}."
                for name, value, low, high in rows
                if not low <= value <= high
            ),
            "",
        )

    def __call__(self, states: Array) -> NDArray[np.bool_]:
        """Returns whether one is outside, shape (...,), for states (..., n_x); a NaN is not."""
        if not self.lowest.size:
            return np.zeros(states.shape[:-1], dtype=bool)
        values = self.readings(states)
        return np.any((values < self.lowest) | (values > self.highest), axis=-1)
