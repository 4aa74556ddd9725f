# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The timers that end a process which hangs with Python's lock held."""

import subprocess
import sys

import pytest

# With PyDLL a call keeps Python's lock: nothing of Python can run in this process any more.
_HANG = """
import ctypes
from vgps_ros.ros_runtime.exit_timer import exit_after
exit_after(0.2, {code})
ctypes.PyDLL(None).pause()
"""


def _exit_code(program: str) -> int:
    return subprocess.run([sys.executable, "-c", program], timeout=20, check=False).returncode


@pytest.mark.parametrize("code", [0, 3])
def test_it_ends_a_process_that_nothing_of_python_can_end(code):
    assert _exit_code(_HANG.format(code=code)) == code


def test_a_process_that_ends_earlier_does_not_wait_for_it():
    assert (
        _exit_code("from vgps_ros.ros_runtime.exit_timer import exit_after; exit_after(60.5, 3)")
        == 0
    )
