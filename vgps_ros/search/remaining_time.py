"""How much longer a run takes."""

import time

from vgps_ros.search.methods import SearchIteration


class RemainingTime:
    """Estimates the time left from the pace so far; the initial solve does not count."""

    def __init__(self, iterations: int):
        self._iterations = iterations
        self._first = 0.0

    def after(self, iteration: SearchIteration) -> float:
        """Returns the time left [s]; call it once as each iteration ends."""
        now = time.monotonic()
        left = self._iterations - iteration.k
        if iteration.k == 1:
            self._first = now
            return left * (iteration.q_step_seconds + iteration.m_step_seconds)
        return left * (now - self._first) / (iteration.k - 1)
