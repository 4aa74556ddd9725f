# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Opens a run's Rerun recording, in the browser where there is no display.

Example: vgps view recordings/mine. Ctrl-C ends it. A demo leaves run.rrd in its folder, and
`vgps bag rerun BAG` makes a recording of any bag. All ports are on 127.0.0.1.
"""

import argparse
import os
import shlex
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.programs.command_line import Parser

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
_SERVER_TIMEOUT = 60.0  # time for the server to answer [s]
_LAST_WAIT = 5.0  # time for the viewer to end before it is killed [s]


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("run", type=Path, help="folder of a run, or a recording (.rrd)")
    parser.add_argument("--web", action="store_true", help="the browser, also with a display")
    parser.add_argument("--port", type=_port, default=0, help="TCP port of the page, 0: any")


def run(arguments: argparse.Namespace) -> None:
    """Opens the recording until the window is closed, or INT or TERM comes."""
    path = _recording_of(arguments.run)
    try:
        if not arguments.web and any(map(os.environ.get, _DISPLAYS)):
            with _running(str(path)) as viewer:
                viewer.wait()
        else:
            with _in_browser(path, arguments.port) as (address, viewer):
                print(f"Open {address}\nCtrl-C ends it.", flush=True)
                viewer.wait()
    except KeyboardInterrupt:
        sys.exit()  # as it is meant to end; after a mere return the interrupt would come again


def _recording_of(path: Path) -> Path:
    """Returns the recording of a run."""
    recording = path / "run.rrd" if path.is_dir() else path
    if not recording.is_file():
        bag = shlex.quote(str(path / "bag")) if (path / "bag").is_dir() else "BAG"
        raise InvalidInputError(
            f"There is no recording '{recording}'; `vgps bag rerun {bag} --output NAME.rrd` makes "
            "one from a bag, and `vgps view NAME.rrd` opens it."
        )
    with recording.open("rb") as file:
        start = file.read(3)
    if start != b"RRF":
        raise InvalidInputError(
            f"'{recording}' is no recording of Rerun; give a file that ends in .rrd, or the folder "
            "of a run that has run.rrd."
        )
    return recording


def _port(text: str) -> int:
    port = int(text)
    if port and not 1024 <= port <= 65535:
        raise argparse.ArgumentTypeError(f"{port} must be 0, or from 1024 to 65535")
    return port


@contextmanager
def _in_browser(recording: Path, port: int = 0) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Serves a recording on a port, or on any; yields the page's address, the server's process."""
    web, data = _free_port(port), _free_port()
    options = ("--serve-web", "--web-viewer-port", str(web), "--port", str(data))
    page = f"http://127.0.0.1:{web}"
    with _running(*options, str(recording)) as viewer:
        end = time.monotonic() + _SERVER_TIMEOUT
        while not _answers(page):
            if viewer.poll() is not None or time.monotonic() > end:
                raise VgpsError(f"Rerun's server does not answer at {page}; its output is above.")
            time.sleep(0.1)
        source = quote(f"rerun+http://127.0.0.1:{data}/proxy", safe="")
        yield f"{page}?url={source}", viewer


@contextmanager
def _running(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    import rerun_cli

    # The program itself: what Python has on the path starts it as a child, which would stay.
    program = Path(str(rerun_cli.__file__)).with_name("rerun")
    process = subprocess.Popen(
        [str(program), "--bind", "127.0.0.1", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        env={"RUST_LOG": "error", **os.environ},
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(_LAST_WAIT)
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
