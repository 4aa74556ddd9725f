# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs a node of the ROS 2 graph.

`vgps node NAME --help` lists the parameters of a node; they are given as ROS arguments:
`vgps node simulation --ros-args -p task:=walker`.
"""

import argparse
import importlib
import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any, NoReturn

from vgps_ros import NODES
from vgps_ros.core.errors import VgpsError
from vgps_ros.ros_runtime.c_memory import use_one_heap
from vgps_ros.ros_runtime.middleware import check_machine

_ENDING = (signal.SIGINT, signal.SIGTERM)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("name", choices=NODES, metavar="NAME", help=f"one of {', '.join(NODES)}")
    parser.add_argument(
        "arguments", nargs=argparse.REMAINDER, metavar="ROS_ARGUMENT", help="see `NAME --help`"
    )


def run(arguments: argparse.Namespace) -> NoReturn:
    """Runs the node that the arguments name."""
    start(arguments.name, arguments.arguments)


def heed(handler: Callable[[int, FrameType | None], Any]) -> None:
    """Lets INT and TERM call a handler, also those that have waited since this process was started.

    The executables start it with both blocked, since Python itself would meet one with a traceback;
    and a shell starts what it puts into the background with INT ignored.
    """
    for number in _ENDING:
        signal.signal(number, handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)


def start(name: str, arguments: Sequence[str]) -> NoReturn:
    """Runs a node, and ends the process.

    The imports of a node take a second or more. A signal that strikes meanwhile ends the process as
    well as a later one does, before anything is open that would have to be closed. Once all is
    closed the process ends at once: Python's own way of taking its modules apart was seen to hang
    there, with the libraries that a node has loaded.
    """
    heed(lambda *_: os._exit(0))
    use_one_heap()
    sys.argv = [name, *arguments]  # where ROS looks for its arguments
    try:
        check_machine()
    except VgpsError as error:
        sys.exit(str(error))
    module = importlib.import_module(f"vgps_ros.nodes.{name}")
    code = 1
    try:
        code = module.main()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
