# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The function that runs every node and ends it, or prints its `--help`."""

import gc
import os
import sys
import traceback
from collections.abc import Callable
from contextlib import chdir, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from rich import box
from rich.table import Table

from vgps_ros.core.errors import VgpsError
from vgps_ros.ros_runtime.ending import PATIENCE, Ending
from vgps_ros.ros_runtime.exit_timer import exit_after
from vgps_ros.ros_runtime.middleware import choose_middleware
from vgps_ros.ros_runtime.parameters import DECLARED
from vgps_ros.ros_runtime.services import guard_services, keep_responses
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.views.table_console import table_console

AnyNode = TypeVar("AnyNode", bound=Node)

# rclpy raises these where the context ends between two of its calls.
_LACKS_CONTEXT = (ExternalShutdownException, RuntimeError, ValueError)


def run(
    make_node: Callable[[], AnyNode],
    make_executor: Callable[[], Executor] = SingleThreadedExecutor,
    close: Callable[[AnyNode, Callable[[], bool]], None] = lambda *_: None,
) -> int:
    """Runs a node until INT or TERM, then destroys it.

    Args:
        make_node: builds the node; a VgpsError from it, or from a callback, ends the node with its
            sentence. For `--help` it is built too, with its defaults, to see its parameters.
        make_executor: builds what runs the callbacks.
        close: completes what the node has begun, and may still publish; of one thread's callbacks
            none runs any more. It is given a function that tells whether the user is in a hurry.

    Returns:
        The process's exit code.
    """
    choose_middleware()
    if (code := _answer_arguments(make_node)) is not None:
        return code
    silence_mujoco()
    ending = Ending()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = make_executor()
    ending.executor = executor
    node, code = None, 0
    try:
        with ending.interrupting():
            node = make_node()
        try:
            guard_services(node)
            keep_responses(node)
            ending.spin(node, executor)
        finally:
            close(node, ending.is_hurried)
    except KeyboardInterrupt:
        pass  # INT or TERM, before the node was made
    except VgpsError as error:
        print(error, file=sys.stderr)
        code = 1
    except Exception as error:
        is_ending = ending.is_wanted or not rclpy.ok()
        if not (is_ending and isinstance(error, _LACKS_CONTEXT)):
            traceback.print_exc()
            code = 1
    exit_after(PATIENCE, code)
    ending.executor = None
    rclpy.try_shutdown()  # ends what still waits
    executor.shutdown()
    if node:
        node.destroy_node()
    del node, executor
    gc.collect()  # what a node that did not come about, or one with a lifecycle, still holds
    return code


def _answer_arguments(make_node: Callable[[], Node]) -> int | None:
    """Prints the help that the arguments ask for, or what is wrong with them.

    Returns:
        The process's exit code, or None if the node is to run.
    """
    name = Path(sys.argv[0]).name
    try:
        arguments = remove_ros_args(sys.argv)[1:]
    except RuntimeError as error:  # it ends with the places in rcl's source
        words = str(error).partition(", at /")[0].removeprefix("Failed to parse ROS arguments: ")
        print(f"{name} cannot start: {' '.join(words.split())}.", file=sys.stderr)
        return 1
    if {"-h", "--help"} & set(arguments):
        _show_help(make_node, name)
        return 0
    if arguments:
        print(
            f"{name} does not know the argument '{arguments[0]}': give its parameters as "
            f"--ros-args -p NAME:=VALUE; `{name} --help` lists them.",
            file=sys.stderr,
        )
        return 1
    return None


def _show_help(make_node: Callable[[], Node], name: str) -> None:
    """Prints a node's description and parameters.

    The node is built with its defaults, in a graph that nobody discovers and in an empty folder, so
    that its parameters need not be listed a second time.
    """
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    with TemporaryDirectory(prefix="vgps_ros_help_") as folder, chdir(folder):
        rclpy.init(
            args=["--ros-args", "--log-level", "fatal"],
            signal_handler_options=SignalHandlerOptions.NO,
        )
        with suppress(VgpsError):  # of one that needs more than its defaults, as a player its bag
            make_node().destroy_node()
        rclpy.try_shutdown()
        gc.collect()  # what such a node, or one with a lifecycle, still holds
    table = Table(box=box.SIMPLE)
    for heading in ("parameter", "default", "what it does (valid values)"):
        table.add_column(heading, overflow="fold")
    for descriptor, default in DECLARED:
        changes = "" if descriptor.read_only else " [may change while it runs]"
        table.add_row(descriptor.name, str(default), descriptor.description + changes)
    print(f"usage: ros2 run vgps_ros {name} [--ros-args -p PARAMETER:=VALUE ...]\n")
    print(sys.modules[make_node.__module__].__doc__)
    table_console().print(table, highlight=False)
