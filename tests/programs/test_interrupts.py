# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import subprocess
import sys
import textwrap

import pytest

_PROGRAM = """
import ctypes, msgspec, os, signal, subprocess, time
from concurrent.futures import ThreadPoolExecutor
from vgps_ros.core.errors import VgpsError
from vgps_ros.programs import __main__, check
from vgps_ros.views import viewer

def strike():
    os.kill(os.getpid(), signal.SIGINT)

class Finalised:
    def __del__(self):
        strike()

class Hashed(type):
    def __hash__(self):
        strike()
        return 1

class LookedUp(metaclass=Hashed):
    pass

def run(_):
{}

check.run = run
__main__.main()
"""
_LOST = "ctypes.CFUNCTYPE(None)(strike)()"


def stderr_of(body: str) -> str:
    """What the program `check` says whose work is this; it must end with 1."""
    script = _PROGRAM.format(textwrap.indent(body, "    "))
    command = [sys.executable, "-c", script, "check", "rotor"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    return done.stderr


@pytest.mark.parametrize(
    "struck", ["strike()", _LOST, "Finalised()", "msgspec.convert(LookedUp(), LookedUp)"]
)
def test_an_interrupt_ends_a_program_also_where_python_loses_the_exception(struck):
    """As in what C calls back, such as loops that numba loads, and in finalisers and lookups."""
    assert stderr_of(f"{struck}\ntime.sleep(20)") == "vgps check: interrupted.\n"


def test_an_interrupt_leaves_no_thread_of_a_pool_for_which_python_would_wait_for_ever():
    """It strikes between the start of the thread and the note by which Python wakes it at the end.

    Here the pool stays alive to the end, as one does that an object in a cycle holds.
    """
    body = """
class Struck(set):
    def add(self, thread):
        strike()
        super().add(thread)

pool = __main__.pool = ThreadPoolExecutor(1)
pool._threads = Struck()
pool.submit(time.sleep, 0)
time.sleep(20)
"""
    assert stderr_of(body) == "vgps check: interrupted.\n"


def test_an_interrupt_leaves_nothing_of_llvm_half_made():
    body = """
from llvmlite.binding.ffi import ObjectRef

class Struck(ObjectRef):
    def __setattr__(self, name, value):
        if not self.__dict__:
            strike()
        super().__setattr__(name, value)

Struck(1)
time.sleep(20)
"""
    assert stderr_of(body) == "vgps check: interrupted.\n"


def test_an_interrupt_leaves_no_process_that_a_program_has_just_started():
    """The process would keep stderr open, for the end of which the test waits."""
    body = """
execute = subprocess.Popen._execute_child

def struck(self, *given):
    execute(self, *given)
    strike()

subprocess.Popen._execute_child = struck
with viewer._running(["sleep", "90"]):
    time.sleep(20)
"""
    assert stderr_of(body) == "vgps check: interrupted.\n"


def test_an_interrupt_leaves_time_to_clean_up():
    body = """
try:
    strike()
    time.sleep(20)
finally:
    time.sleep(0.3)
    print("all is closed", file=__main__.sys.stderr)
"""
    assert stderr_of(body) == "all is closed\nvgps check: interrupted.\n"


@pytest.mark.parametrize("error", ["RuntimeError", "VgpsError"])
def test_an_error_that_follows_an_interrupt_is_no_error_of_the_program(error):
    """As of numba, which lacks the compiled loop whose compilation was interrupted."""
    failure = f'raise {error}("no compiled object yet")'
    assert stderr_of(f"{_LOST}\n{failure}") == "vgps check: interrupted.\n"
    told = "vgps check: no compiled object yet\n" if error == "VgpsError" else f"\n{error}: no"
    assert told in stderr_of(failure)


def test_an_interrupt_of_a_program_that_is_ending_shows_nothing():
    """The last thing that a program does is to ignore what may come again, in signal.py.

    SIG_IGN is no way to ignore it: Python may print that it lost the signal to a race.
    """
    body = """
import signal
ignore = signal.signal

def struck(number, handler):
    assert handler is not signal.SIG_IGN
    strike()
    time.sleep(0.2)
    return ignore(number, handler)

signal.signal = struck
raise VgpsError("all is closed")
"""
    assert stderr_of(body) == "vgps check: all is closed\n"
