# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Has the C library give back what a node has no use for any more, where that is the GNU one.

By itself it keeps what large messages took. It has one heap for each thread, too, and of those of
other threads than the main one it never gives back the end: a flood of messages of 1 MB left 17 MB
in an executor for good, and leaves 1 or 2 MB with a single heap that is trimmed.
"""

import ctypes
from typing import Any

_ARENA_MAX = -8  # M_ARENA_MAX of malloc.h: the largest number of heaps


def use_one_heap() -> None:
    """Has all threads that begin from now on share the heap of the main one."""
    _call("mallopt", _ARENA_MAX, 1)


def trim() -> None:
    """Gives back all pages of the heaps that are free."""
    _call("malloc_trim", 0)


def _call(name: str, *arguments: Any) -> None:
    if function := getattr(ctypes.CDLL(None), name, None):
        function(*arguments)
