"""Limits of torques, and of their change."""

import numpy as np

from vgps_ros.core.records import Array


class TorqueLimiter:
    """Clips torques, also to what the torques of the state before allow.

    The change counts from the last torques that an earlier state led to, so that a state that is
    sent twice gets the same answer twice, or from those of the safe action since. Where there are
    none, or time went back, torques start from zero.

    Args:
        limits: shape (n_u,), [N·m].
        rate: largest change over time [N·m/s]; 0: no limit.
        period: of the control [s]; a longer silence allows no larger change.
    """

    def __init__(self, limits: Array, rate: float, period: float):
        self._limits, self._rate, self._period = limits, rate, period
        # Stamp [ns] and torques of the latest command, and of the one before it; the stamp is
        # -1 of torques that answered no state.
        start = (-1, np.zeros_like(limits))
        self._start = self._latest = self._earlier = start

    def clipped(self, torques: Array) -> Array:
        """Returns torques within the limits, shape (n_u,), [N·m]."""
        return _clip(torques, -self._limits, self._limits)

    def limited(self, torques: Array, stamp: int) -> Array:
        """Returns torques within all limits, shape (n_u,), [N·m], for the state of a stamp [ns]."""
        torques = self.clipped(torques)
        if not self._rate:
            return torques
        before_stamp, before = self._before(stamp)
        elapsed = self._period
        if before_stamp >= 0:
            elapsed = min(elapsed, (stamp - before_stamp) * 1e-9)
        return _clip(torques, before - self._rate * elapsed, before + self._rate * elapsed)

    def note(self, torques: Array, stamp: int) -> None:
        """Takes note of torques that were sent, from which the next ones may change."""
        self._earlier = self._before(stamp)
        self._latest = (stamp, torques)

    def note_safe(self, torques: Array) -> None:
        """Takes note of torques of the safe action, from which every next one may change."""
        self._latest = self._earlier = (-1, torques)

    def _before(self, stamp: int) -> tuple[int, Array]:
        if stamp > self._latest[0]:
            return self._latest
        return self._earlier if stamp == self._latest[0] else self._start


def _clip(values: Array, lowest: Array, highest: Array) -> Array:
    """np.clip in less than half of its time, which counts between a state and its command."""
    return np.minimum(np.maximum(values, lowest), highest)
