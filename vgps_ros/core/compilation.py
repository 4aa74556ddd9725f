# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compiles functions, and keeps their machine code between processes where a folder allows it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba import njit
from numba.core import event


def compile_at_first_call(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a function at its first call, to run without Python's lock.

    The machine code is kept beside the source or in the user's cache folder; where neither can be
    written, each process compiles anew. A division by zero gives inf or NaN.
    """
    options: dict[str, Any] = {"nogil": True, "no_cfunc_wrapper": True, "error_model": "numpy"}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # numba found no folder for its cache
        return njit(**options)(function)


def compiled_part(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a function that only compiled ones call, and that makes no array.

    It counts no references, which for a simulation's many arrays took most of the time of
    compiling, and has no entry from Python; the machine code of its callers contains it.
    """
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
    return njit(error_model="numpy", **options)(function)


@contextmanager
def before_first_compilation(call: Callable[[], None]) -> Iterator[None]:
    """Calls a function as soon as something has to be compiled in the block, and only then."""
    with event.install_listener("numba:compile", _First(call)):
        yield


class _First(event.Listener):
    """Calls a function at the first event."""

    def __init__(self, call: Callable[[], None]):
        self._call: Callable[[], None] | None = call

    def on_start(self, _: event.Event) -> None:
        call, self._call = self._call, None
        if call:
            call()

    def on_end(self, _: event.Event) -> None:
        """Nothing is done at an end."""
