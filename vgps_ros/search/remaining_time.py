"""An estimate of the time that a run still takes."""

import time

from vgps_ros.search.metrics import IterationMetrics


class RemainingTime:
    """Estimates the time left from the pace so far; the initial solve does not count."""

    def __init__(self, iterations: int):
        self._iterations = iterations
        self._first: tuple[int, float] | None = None  # k and time of the first call

    def after(self, iteration: IterationMetrics) -> float:
        """Returns the time left [s]; call it once as each iteration ends."""
        now = time.monotonic()
        left = self._iterations - iteration.k
        if self._first is None:
            self._first = (iteration.k, now)
            return left * (iteration.q_step_seconds + iteration.m_step_seconds)
        k, began = self._first
        return left * (now - began) / (iteration.k - k)
