# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compiles functions, and keeps their machine code between processes where a folder allows it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba import config, njit
from numba.core import event
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator


@cache
def _stamp_of_parts() -> bytes:
    """Returns a digest of the files whose parts other files compile into their functions."""
    files = sorted(Path(__file__).parents[1].rglob("compiled_*.py"))
    return sha256(b"".join(file.read_bytes() for file in files)).digest()


class _StampedByParts:
    """Keeps machine code until any compiled part has changed.

    Numba alone looks at the file of the function, and not at those of the parts that it contains.
    """

    def get_source_stamp(self) -> object:
        """Returns what must be the same for machine code to be used again."""
        return super().get_source_stamp(), _stamp_of_parts()  # type: ignore[misc]


class InGivenFolder(_StampedByParts, UserProvidedCacheLocator):
    """Keeps machine code in the folder that NUMBA_CACHE_DIR names."""


class BesideSource(_StampedByParts, InTreeCacheLocator):
    """Keeps machine code beside the source."""


class InUsersFolder(_StampedByParts, UserWideCacheLocator):
    """Keeps machine code in the user's cache folder."""


_LOCATORS = ",".join(
    f"{__name__}.{k.__name__}" for k in (InGivenFolder, BesideSource, InUsersFolder)
)


def compile_at_first_call(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a function at its first call, to run without Python's lock.

    The machine code is kept beside the source or in the user's cache folder; where neither can be
    written, each process compiles anew. A division by zero gives inf or NaN.
    """
    options: dict[str, Any] = {"nogil": True, "no_cfunc_wrapper": True, "error_model": "numpy"}
    settings: Any = config
    before, settings.CACHE_LOCATOR_CLASSES = settings.CACHE_LOCATOR_CLASSES, _LOCATORS
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # numba found no folder for its cache
        return njit(**options)(function)
    finally:
        settings.CACHE_LOCATOR_CLASSES = before


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
