"""Starts the node that the executable is named after, and ends its process.

The imports of a node take a second or more. A signal that strikes meanwhile ends the process as
well as a later one does, before anything is open that would have to be closed. Once all is closed
the process ends at once: Python's own way of taking its modules apart was seen to hang there, with
the libraries that a node has loaded.
"""

import importlib
import os
import signal
import sys
import traceback
from pathlib import Path


def main() -> None:
    """Imports the node's module, runs it, and ends the process."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    code = 1
    try:
        code = importlib.import_module(f"vgps_ros.nodes.{Path(sys.argv[0]).name}").main()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
