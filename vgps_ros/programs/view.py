# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Opens a run's Rerun recording, in the browser where there is no display.

Example: vgps view recordings/mine. Ctrl-C ends it. A demo leaves run.rrd in its folder, and
`vgps bag rerun BAG` makes a recording of any bag.
"""

import argparse
import os
import sys
from pathlib import Path

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.programs.command_line import Parser

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("run", type=Path, help="folder of a run, or a recording (.rrd)")
    parser.add_argument("--web", action="store_true", help="the browser, also with a display")
    parser.add_argument("--port", type=_port, default=0, help="TCP port of the page, 0: any")


def run(arguments: argparse.Namespace) -> None:
    """Opens the recording until the window is closed, or INT or TERM comes."""
    path = recording_of(arguments.run)
    from vgps_ros.views.viewer import in_browser, on_screen

    try:
        if not arguments.web and any(map(os.environ.get, _DISPLAYS)):
            with on_screen(path) as viewer:
                viewer.wait()
        else:
            with in_browser(path, arguments.port) as (address, viewer):
                print(f"Open {address}\nCtrl-C ends it.", flush=True)
                viewer.wait()
    except KeyboardInterrupt:
        sys.exit()  # as it is meant to end; after a mere return the interrupt would come again


def recording_of(path: Path) -> Path:
    """Returns the recording of a run.

    Raises:
        InvalidInputError: there is none, or the file is no recording.
    """
    recording = path / "run.rrd" if path.is_dir() else path
    if not recording.is_file():
        bag = path / "bag" if (path / "bag").is_dir() else "BAG"
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
