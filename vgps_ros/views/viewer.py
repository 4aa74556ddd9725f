# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Rerun's viewer for a recording, on this machine's screen or in its browser.

All ports are on 127.0.0.1.
"""

import os
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

import rerun_cli

from vgps_ros.core.errors import VgpsError

# The program itself: what Python has on the path starts it as a child, which would stay.
_VIEWER = (str(Path(str(rerun_cli.__file__)).with_name("rerun")), "--bind", "127.0.0.1")
_PATIENCE = 60.0  # for a server to answer [s]
_ENDING = 5.0  # in which the viewer ends [s]


@contextmanager
def on_screen(recording: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Opens a window; the viewer's process, which ends with the window, is ended at the end."""
    with _running([*_VIEWER, str(recording)]) as viewer:
        yield viewer


@contextmanager
def in_browser(recording: Path, port: int = 0) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Serves a recording until the end; yields the page's address and the server's process.

    Args:
        recording: the file.
        port: TCP port of the page; 0 for any that is free.

    Raises:
        VgpsError: the port is taken, or the server does not answer.
    """
    web, data = _free_port(port), _free_port()
    options = ("--serve-web", "--web-viewer-port", str(web), "--port", str(data))
    page = f"http://127.0.0.1:{web}"
    with _running([*_VIEWER, *options, str(recording)]) as viewer:
        end = time.monotonic() + _PATIENCE
        while not _answers(page):
            if viewer.poll() is not None or time.monotonic() > end:
                raise VgpsError(f"Rerun's server does not answer at {page}; its output is above.")
            time.sleep(0.1)
        source = quote(f"rerun+http://127.0.0.1:{data}/proxy", safe="")
        yield f"{page}?url={source}", viewer


@contextmanager
def _running(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        env={"RUST_LOG": "error", **os.environ},
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(_ENDING)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _free_port(port: int = 0) -> int:
    with socket.socket() as found:
        try:
            found.bind(("127.0.0.1", port))
        except OSError as error:
            raise VgpsError(f"Port {port} is taken; choose another one, or 0 for any.") from error
        return int(found.getsockname()[1])


def _answers(address: str) -> bool:
    try:
        urllib.request.urlopen(address, timeout=5).close()
    except OSError:
        return False
    return True
