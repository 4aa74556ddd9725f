"""Starts the node that the executable is named after.

The imports of a node take a second or more. A signal that strikes meanwhile ends the process as
well as a later one does, before anything is open that would have to be closed.
"""

import importlib
import os
import signal
import sys
from pathlib import Path


def main() -> None:
    """Imports the node's module and runs it."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    name = Path(sys.argv[0]).name
    importlib.import_module(f"vgps_ros.nodes.{name}").main()
