# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Timers that end the process, whatever it is doing.

Where a call into a library hangs and holds Python's lock, no thread and no signal handler of Python
runs any more. The GNU C library's timers do: these call `unlink` and `_exit` in threads of their
own. Python itself has no timer that works without its lock.
"""

import ctypes
import os
from itertools import chain
from typing import Any

from vgps_ros.ros_runtime.shared_memory import files_of, is_port, owned_segments

_CLOCK_MONOTONIC = 1
_SIGEV_THREAD = 2
_UNLINKING = 0.1  # in which files are removed before the end [s]
_paths: list[ctypes.Array[ctypes.c_char]] = []  # as long as a timer may read them


class _Event(ctypes.Structure):
    """`struct sigevent` of the GNU C library, whose notification is a function."""

    _fields_ = (
        ("value", ctypes.c_long),
        ("signal", ctypes.c_int),
        ("notification", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("reserved", ctypes.c_char * 40),
    )


def exit_after(seconds: float, code: int) -> None:
    """Ends the process with this exit code after a time [s], unless it has ended by then.

    Its segments of the middleware's shared memory go with it, which nobody else would remove.
    """
    library = ctypes.CDLL(None, use_errno=True)
    # A port may be another process's by then.
    segments = (s for s in owned_segments(os.getpid()) if not is_port(s))
    for file in chain.from_iterable(map(files_of, segments)):
        path = ctypes.create_string_buffer(os.fsencode(file))
        _paths.append(path)
        _call_after(library, seconds, library.unlink, ctypes.addressof(path))
    _call_after(library, seconds + _UNLINKING, library._exit, code)


def _call_after(library: ctypes.CDLL, seconds: float, call: Any, argument: int) -> None:
    function = ctypes.cast(call, ctypes.c_void_p).value
    event = _Event(value=argument, notification=_SIGEV_THREAD, function=function)
    timer = ctypes.c_void_p()
    whole, rest = divmod(seconds, 1.0)
    times = (ctypes.c_long * 4)(0, 0, int(whole), round(1e9 * rest))  # struct itimerspec
    if library.timer_create(_CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)):
        raise OSError(ctypes.get_errno(), "The timer of the process's end could not be made")
    library.timer_settime(timer, 0, ctypes.byref(times), None)
