# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds where an executed motion leaves the tube of q(ζ), and whether it then only runs late.

A policy sees no time. It may go on with the same gait a little earlier or later than q's mean,
which takes it out of the tube although nothing is wrong with it.
"""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.records import Array

_WIDTH = 2.0  # half the width of the tube [sd]
_LASTING = 0.1  # time for which an angle must be outside: touching the edge is no departure [s]
_WINDOW = 2.0  # time after a departure that is compared [s]
_LONGEST_SHIFT = 0.5  # [s]
_SAME = 0.5  # a shift explains a departure if no more than this share of the distance is left


@dataclass(frozen=True)
class Departure:
    """A departure of the executed motion from the tube.

    Attributes:
        time: when the first coordinate leaves [s].
        coordinate: which one it is, an index into the columns that were given.
        delay: how much later the motion then is than q's mean [s], negative where it is earlier;
            None if no shift explains the departure.
    """

    time: float
    coordinate: int
    delay: float | None

    def __str__(self) -> str:
        if self.delay is None:
            return f"leaves q ± 2 sd at {self.time:.1f} s for another motion"
        late = "later" if self.delay > 0 else "earlier"
        same = f"for the same motion, {abs(self.delay):.2f} s {late}"
        return f"leaves q ± 2 sd at {self.time:.1f} s {same}"


def find_departure(
    executed: Array, mean: Array, deviation: Array, time_step: float
) -> Departure | None:
    """Returns where the executed motion leaves mean ± 2 sd, or None if it stays within.

    Args:
        executed: coordinates of the executed motion, shape (N+1, m).
        mean: those of q's mean, shape (T+1, m).
        deviation: their standard deviations in q, shape (T+1, m).
        time_step: time between two rows [s].
    """
    steps = min(len(executed), len(mean))
    executed, mean, deviation = executed[:steps], mean[:steps], deviation[:steps]
    outside = np.abs(executed - mean) > _WIDTH * deviation + 1e-9
    lasting = max(1, round(_LASTING / time_step))
    if steps < lasting:
        return None
    held = np.all(np.lib.stride_tricks.sliding_window_view(outside, lasting, axis=0), axis=-1)
    if not held.any():
        return None
    first = int(held.any(axis=1).argmax())
    after = slice(first, first + round(_WINDOW / time_step))
    delay = _delay(executed[after], mean[after], round(_LONGEST_SHIFT / time_step))
    return Departure(
        first * time_step, int(held[first].argmax()), None if delay is None else delay * time_step
    )


def _delay(executed: Array, mean: Array, longest: int) -> int | None:
    """Returns by how many steps `executed` lags behind `mean`, if that explains their distance."""
    longest = min(longest, len(mean) // 2)
    scale = mean.std(axis=0) + 1e-9

    def distance(shift: int) -> float:
        late, early = (executed[shift:], mean) if shift >= 0 else (executed, mean[-shift:])
        shared = min(len(late), len(early))
        return float(np.sqrt(np.mean(((late[:shared] - early[:shared]) / scale) ** 2)))

    shifts = range(-longest, longest + 1)
    best = min(shifts, key=distance, default=0)
    return best if best and distance(best) < _SAME * distance(0) else None
