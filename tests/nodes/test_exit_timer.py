# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The timers that end a process which hangs with Python's lock held."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.nodes.conftest import remove_orphans
from vgps_ros.ros_runtime.shared_memory import files_of, is_port

# With PyDLL a call keeps Python's lock: nothing of Python can run in this process any more.
_HANG = """
import ctypes
from vgps_ros.ros_runtime.exit_timer import exit_after
exit_after(0.2, {code})
ctypes.PyDLL(None).pause()
"""
_NODE = """
import os
import rclpy
from vgps_ros.ros_runtime.shared_memory import owned_segments
rclpy.init()
node = rclpy.create_node("hangs")
print(*owned_segments(os.getpid()), sep="\\n", flush=True)
"""


def _exit_code(program: str) -> int:
    return subprocess.run([sys.executable, "-c", program], timeout=20, check=False).returncode


@pytest.mark.parametrize("code", [0, 3])
def test_it_ends_a_process_that_nothing_of_python_can_end(code):
    assert _exit_code(_HANG.format(code=code)) == code


def test_it_leaves_no_shared_memory(domain_id):
    """An orphaned segment holds 35 MB until the machine starts anew."""
    done = subprocess.run(
        [sys.executable, "-c", _NODE + _HANG.format(code=0)],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain_id)},
        timeout=20,
        check=True,
        capture_output=True,
        text=True,
    )
    segments = {Path(line) for line in done.stdout.split()}
    ports = set(filter(is_port, segments))
    remove_orphans(ports)
    assert segments > ports
    assert not [file for segment in segments for file in files_of(segment) if file.exists()]


def test_a_process_that_ends_earlier_does_not_wait_for_it():
    assert (
        _exit_code("from vgps_ros.ros_runtime.exit_timer import exit_after; exit_after(60.5, 3)")
        == 0
    )
