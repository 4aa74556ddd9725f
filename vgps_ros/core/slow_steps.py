# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Prints a notice when a step is slow."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_DELAY = 2.0  # time after which a notice is printed [s]
_EVERY = 10.0  # time between lines of progress [s]


@contextmanager
def notice_if_slow(sentence: str) -> Iterator[None]:
    """Prints a sentence if the block takes more than 2 s."""
    timer = threading.Timer(_DELAY, print, (sentence,), {"flush": True})
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def progress_lines(what: str) -> Callable[[float], None]:
    """Returns a function that takes the share that is done, and prints it every 10 s."""
    began = time.monotonic()
    due = began + _DELAY

    def report(share: float) -> None:
        nonlocal due
        now = time.monotonic()
        if now < due or share >= 1.0:
            return
        due = now + _EVERY
        left = (now - began) * (1.0 - share) / share
        print(f"{what}: {100 * share:.0f} %, about {left:.0f} s left.", flush=True)

    return report
