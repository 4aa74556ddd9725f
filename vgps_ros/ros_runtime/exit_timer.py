# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A timer that ends the process, whatever it is doing.

Where a call into a library hangs and holds Python's lock, no thread and no signal handler of Python
runs any more. The GNU C library's timers do: this one calls `_exit` in a thread of its own. Python
itself has no timer that works without its lock.
"""

import ctypes

_CLOCK_MONOTONIC = 1
_SIGEV_THREAD = 2


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
    """Ends the process with this exit code after a time [s], unless it has ended by then."""
    library = ctypes.CDLL(None, use_errno=True)
    function = ctypes.cast(library._exit, ctypes.c_void_p).value
    event = _Event(value=code, notification=_SIGEV_THREAD, function=function)
    timer = ctypes.c_void_p()
    whole, rest = divmod(seconds, 1.0)
    times = (ctypes.c_long * 4)(0, 0, int(whole), round(1e9 * rest))  # struct itimerspec
    if library.timer_create(_CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)):
        raise OSError(ctypes.get_errno(), "The timer of the process's end could not be made")
    library.timer_settime(timer, 0, ctypes.byref(times), None)
