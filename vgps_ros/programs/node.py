# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs a node of the ROS 2 graph.

`vgps node NAME --help` lists the parameters of a node; they are given as ROS arguments:
`vgps node simulation --ros-args -p task:=walker`.
"""

import argparse
import importlib
import sys
from collections.abc import Sequence
from typing import NoReturn

from vgps_ros import NODES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("name", choices=NODES, metavar="NAME", help=f"one of {', '.join(NODES)}")
    parser.add_argument(
        "arguments", nargs=argparse.REMAINDER, metavar="ROS_ARGUMENT", help="see `NAME --help`"
    )


def run(arguments: argparse.Namespace) -> NoReturn:
    """Runs the node that the arguments name."""
    start(arguments.name, arguments.arguments)


def start(name: str, arguments: Sequence[str]) -> NoReturn:
    """Runs a node and ends the process, also where INT or TERM comes while it is imported."""
    sys.argv = [name, *arguments]  # where ROS looks for its arguments
    try:
        code = importlib.import_module(f"vgps_ros.nodes.{name}").main()
    except KeyboardInterrupt:
        code = 0
    sys.exit(code)
