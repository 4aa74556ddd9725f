# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""INT and TERM that strike while rclpy is making a node, in a node's process and in a client's."""

import os
import signal
import subprocess
import sys

import pytest

# rclpy iterates over the overrides of parameters in the midst of its constructor.
_PROGRAM = """
import os, signal, sys, time
from rclpy.node import Node
from vgps_ros.ros_runtime.client_node import client_node
from vgps_ros.ros_runtime.runner import run

class Struck(list):
    def __iter__(self):
        os.kill(os.getpid(), {number})
        time.sleep({seconds})
        return super().__iter__()

class Slow(Node):
    def __init__(self, *_):
        super().__init__("slow", parameter_overrides=Struck())
        print("made by rclpy", flush=True)
        time.sleep(300.0)

if "{kind}" == "node":
    sys.exit(run(Slow))
try:
    with client_node(Slow):
        print("goes on")
except KeyboardInterrupt:
    sys.exit(1)
"""


def _ends(kind: str, number: int, seconds: float, domain_id: int) -> tuple[int, list[str], str]:
    """Runs the program to its end; returns its code, its further output and the errors."""
    program = _PROGRAM.format(kind=kind, number=int(number), seconds=seconds)
    ended = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain_id)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return ended.returncode, ended.stdout.splitlines(), ended.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("kind", "code"), [("node", 0), ("client", 1)])
def test_what_rclpy_makes_is_whole_before_a_signal_ends_the_process(kind, code, number, domain_id):
    assert _ends(kind, number, 0.3, domain_id) == (code, ["made by rclpy"], "")


@pytest.mark.parametrize(("kind", "code"), [("node", 0), ("client", 1)])
def test_a_start_that_hangs_within_rclpy_is_cut_off(kind, code, domain_id):
    assert _ends(kind, signal.SIGTERM, 300.0, domain_id) == (code, [], "")


_LOST = """
import ctypes, os, signal, time
from vgps_ros.ros_runtime.ending import Ending

ending = Ending()
with ending.interrupting():
    ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT))()
    time.sleep(20.0)
"""


def test_an_interrupt_that_c_code_drops_comes_again_and_is_not_told():
    """As in what compiles loops; Ending's own KeyboardInterrupt ends the program."""
    command = [sys.executable, "-c", _LOST]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert "ignored" not in ended.stderr
    assert ended.returncode == -signal.SIGINT
