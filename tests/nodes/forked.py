# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Starts commands of `vgps` in processes that have imported most packages already.

Imports are half of what the start of a node costs, and 300 are started. So one process imports what
has nothing to do with ROS, since rclpy starts threads as it is imported, which no fork has. Each
command goes on in a fork of that process: with an environment, output, signals and an end of its
own, as if it were typed.
"""

import atexit
import multiprocessing
import os
import subprocess
import sys
from multiprocessing import forkserver
from pathlib import Path

from vgps_ros.programs.__main__ import main

_PRELOADED = [
    "tests.nodes.forked",
    "vgps_ros.programs.command_line",
    "vgps_ros.search.training",
    "vgps_ros.tasks",
]


def prepare() -> None:
    """Begins to import, in the background."""
    multiprocessing.set_forkserver_preload(_PRELOADED)
    forkserver.ensure_running()


class ForkedCommand:
    """A command of `vgps` that runs in a process of its own; used as a `subprocess.Popen`."""

    def __init__(self, words: list[str], environment: dict[str, str], output: Path):
        context = multiprocessing.get_context("forkserver")
        self._words = words
        self._process = context.Process(target=_run, args=(words, environment, str(output)))
        self._process.start()

    @property
    def pid(self) -> int:
        assert self._process.pid
        return self._process.pid

    def poll(self) -> int | None:
        """Returns the exit code, or the signal that ended it as a negative number; or None."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Waits for the end and returns the exit code; raises subprocess.TimeoutExpired."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self._words, timeout or 0.0)
        return self._process.exitcode

    def send_signal(self, number: int) -> None:
        """Sends a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Sends KILL."""
        self._process.kill()


def _run(words: list[str], environment: dict[str, str], output: str) -> None:
    os.environ.clear()
    os.environ.update(environment)
    file = os.open(output, os.O_WRONLY | os.O_APPEND)
    for stream in (1, 2):
        os.dup2(file, stream)
    os.close(file)
    for text in (sys.stdout, sys.stderr):
        text.reconfigure(write_through=True)
    sys.argv = ["vgps", *words]
    try:
        main()
    finally:
        atexit._run_exitfuncs()  # which a process of multiprocessing leaves out
