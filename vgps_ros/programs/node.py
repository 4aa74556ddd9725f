# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs a node of the ROS 2 graph, or several in one process.

`vgps node NAME --help` lists the parameters of a node; they are given as ROS arguments:
`vgps node simulation --ros-args -p task:=walker`. Several nodes share a process, in which messages
between them take less time: `vgps node simulation policy_executor --ros-args -p task:=walker -p
simulation:mode:=real_time`. What ends one of them ends all.
"""

import argparse
import importlib
import sys
from collections.abc import Sequence
from itertools import takewhile
from typing import NoReturn

from vgps_ros import NODES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument(
        "name", choices=NODES, metavar="NAME", help=f"one or more of {', '.join(NODES)}"
    )
    parser.add_argument(
        "arguments", nargs=argparse.REMAINDER, metavar="ROS_ARGUMENT", help="see `NAME --help`"
    )


def run(arguments: argparse.Namespace) -> NoReturn:
    """Runs the nodes that the arguments name."""
    start([arguments.name, *arguments.arguments])


def start(words: Sequence[str]) -> NoReturn:
    """Runs nodes and ends the process, also where INT or TERM comes while they are imported.

    Args:
        words: the nodes' names, and then their arguments.
    """
    names = list(dict.fromkeys(takewhile(NODES.__contains__, words)))
    arguments = words[len(names) :]
    # Where ROS looks for its arguments.
    sys.argv = [names[0] if len(names) == 1 else " ".join(["node", *names]), *arguments]
    try:
        nodes = [importlib.import_module(f"vgps_ros.nodes.{name}").NODE for name in names]
        from vgps_ros.ros_runtime.runner import run as run_nodes

        code = run_nodes(*nodes)
    except KeyboardInterrupt:
        code = 0
    sys.exit(code)
