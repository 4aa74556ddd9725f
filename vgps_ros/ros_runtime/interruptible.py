# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Tells where the handler of a signal may raise KeyboardInterrupt, and whether it was raised.

Code in C that calls back into Python may drop any exception: finalisers, numba where it loads
compiled loops, and each lookup in a dictionary that clears errors, as msgspec's are. So who raises
an interrupt looks again a little later, and raises it once more if it is gone.
"""

import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Thread
from types import FrameType
from typing import Any

LATER = 0.05  # after which a signal is looked at again [s]
# Extension modules that begin lose the exception, or turn it into an ImportError. A node or an
# executor that rclpy has half made prints a traceback and does not say goodbye to the others. What
# measures the coverage keeps a lock for ever. What llvmlite has half made prints a traceback as it
# is finalised.
_UNSAFE = {
    "importlib",
    "_frozen_importlib",
    "_frozen_importlib_external",
    "rclpy",
    "coverage",
    "llvmlite",
}
# An exception between the start of a thread or process and the note that there is one leaves it to
# itself: Python then waits for ever for the thread of a pool, as it ends, and a child runs on.
_STARTING = (Thread.start, ThreadPoolExecutor.submit, subprocess.Popen.__init__)


def may_raise(frame: FrameType | None) -> bool:
    """Returns whether an exception in a thread's frame would reach the program, and do no harm."""
    if any(is_within(function, frame) for function in _STARTING):
        return False
    while frame:
        if str(frame.f_globals.get("__name__")).partition(".")[0] in _UNSAFE:
            return False
        frame = frame.f_back
    return True


def is_within(function: Callable[..., Any], frame: FrameType | None) -> bool:
    """Returns whether a call of the function is under way in a thread's frame."""
    while frame and frame.f_code is not function.__code__:
        frame = frame.f_back
    return frame is not None


def is_raised() -> bool:
    """Returns whether KeyboardInterrupt is on its way out, through what cleans up behind it."""
    error = sys.exc_info()[1]
    while error and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def tell_lost(lost: "sys.UnraisableHookArgs") -> None:
    """Tells of an exception that Python has lost, but for interrupts, which come again."""
    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
