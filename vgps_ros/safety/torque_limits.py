# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Limits torques and the rate at which they change."""

import numpy as np

from vgps_ros.core.records import Array


class TorqueLimiter:
    """Clips torques to limits of their size and of their change.

    The change is measured from the torques that answered the latest earlier state, or from those of
    the safe action if they were sent later. So a state that comes twice gets the same answer twice.
    Torques start from zero if there are no such torques, or if time went back.

    Args:
        limits: lowest and highest torques, shapes (n_u,) [N·m].
        rate: largest change over time [N·m/s]; 0 for no limit.
        period: control period [s]. The change is limited as if no more time had passed.
    """

    def __init__(self, limits: tuple[Array, Array], rate: float, period: float):
        self._limits, self._rate, self._period = limits, rate, period
        # Stamp [ns] and torques of the latest command, and of the command before it. Torques that
        # answered no state have the stamp -1.
        start = (-1, np.zeros_like(limits[0]))
        self._start = self._latest = self._earlier = start

    def clipped(self, torques: Array) -> Array:
        """Returns torques within the limits of their size, shape (n_u,) [N·m]."""
        return _clip(torques, *self._limits)

    def limited(self, torques: Array, stamp: int) -> Array:
        """Returns torques within all limits, shape (n_u,) [N·m], for a state's stamp [ns]."""
        torques = self.clipped(torques)
        if not self._rate:
            return torques
        before_stamp, before = self._before(stamp)
        elapsed = self._period
        if before_stamp >= 0:
            elapsed = min(elapsed, (stamp - before_stamp) * 1e-9)
        return _clip(torques, before - self._rate * elapsed, before + self._rate * elapsed)

    def note(self, torques: Array, stamp: int) -> None:
        """Remembers torques that were sent, from which the next change is measured."""
        self._earlier = self._before(stamp)
        self._latest = (stamp, torques)

    def note_safe(self, torques: Array) -> None:
        """Remembers torques of the safe action, from which the next change is measured."""
        self._latest = self._earlier = (-1, torques)

    def _before(self, stamp: int) -> tuple[int, Array]:
        if stamp > self._latest[0]:
            return self._latest
        return self._earlier if stamp == self._latest[0] else self._start


def _clip(values: Array, lowest: Array, highest: Array) -> Array:
    """Clips values as np.clip does, in less than half of its time."""
    return np.minimum(np.maximum(values, lowest), highest)
