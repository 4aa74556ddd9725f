# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Has the C library give back what a node has no use for any more, where that is the GNU one.

By itself it keeps what large messages took. It also makes a heap for each thread, and never gives
back the end of a heap other than the main one: a flood of messages of 1 MB left 17 MB in an
executor for good. With a single heap that is trimmed it leaves 1 or 2 MB.
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
