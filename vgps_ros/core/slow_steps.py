# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Prints how far a step is, where it is slow."""

import sys
import time
from collections.abc import Callable

_DELAY = 2.0  # time after which progress is printed [s]
_EVERY = 10.0  # time between lines of progress [s]
_LEAST = 0.05  # share from which on the time left can be told


def progress_lines(what: str) -> Callable[[float], None]:
    """Returns a function that takes the share that is done, and prints it every 10 s.

    It prints to the standard error, as what a command answers goes to the standard output.
    """
    began = time.monotonic()
    due = began + _DELAY

    def report(share: float) -> None:
        nonlocal due
        now = time.monotonic()
        if now < due or not _LEAST <= share < 1.0:
            return
        due = now + _EVERY
        left = (now - began) * (1.0 - share) / share
        print(f"{what}: {100 * share:.0f} %, about {left:.0f} s left.", file=sys.stderr, flush=True)

    return report
