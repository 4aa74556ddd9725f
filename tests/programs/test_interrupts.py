# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import pytest

_BEGINNING = """
import ctypes, msgspec, os, signal, sys, time
from vgps_ros.programs.__main__ import _heed_interrupts

class Finalised:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

class Hashed(type):
    def __hash__(self):
        os.kill(os.getpid(), signal.SIGINT)
        return 1

class LookedUp(metaclass=Hashed):
    pass

_heed_interrupts()
try:
    {}
    time.sleep(20)
except KeyboardInterrupt:
    sys.exit(3)
"""


@pytest.mark.parametrize(
    "struck",
    [
        "os.kill(os.getpid(), signal.SIGINT)",
        "ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT))()",
        "Finalised()",
        "msgspec.convert(LookedUp(), LookedUp)",
    ],
)
def test_an_interrupt_ends_a_program_also_where_python_loses_the_exception(struck):
    """As in what C calls back, such as loops that numba loads, and in finalisers and lookups."""
    script = [sys.executable, "-c", _BEGINNING.format(struck)]
    done = subprocess.run(script, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (3, "")


_FAILING = """
import ctypes, os, signal, sys
from vgps_ros.programs import __main__, check

def run(_):
    if sys.argv[2] == "interrupted":
        ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT))()
    raise RuntimeError("no compiled object yet")

check.run = run
__main__.main()
"""


@pytest.mark.parametrize("task", ["interrupted", "undisturbed"])
def test_an_error_that_follows_an_interrupt_is_no_error_of_the_program(task):
    """As of numba, which lacks the compiled loop whose compilation was interrupted."""
    script = [sys.executable, "-c", _FAILING, "check", task]
    done = subprocess.run(script, check=False, capture_output=True, text=True)
    assert done.returncode == 1
    if task == "interrupted":
        assert done.stderr == "vgps check: interrupted.\n"
    else:
        assert done.stderr.endswith("RuntimeError: no compiled object yet\n")
