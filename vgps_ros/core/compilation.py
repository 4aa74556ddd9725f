# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compiles functions, and keeps their machine code between processes where a folder allows it."""

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a function at its first call, to run without Python's lock.

    The machine code is kept beside the source or in the user's cache folder; where neither can be
    written, each process compiles anew.
    """
    try:
        return njit(cache=True, nogil=True)(function)
    except RuntimeError:  # numba found no folder for its cache
        return njit(nogil=True)(function)
