"""A node's `--help`: a description of the node, and the parameters that it declares."""

import gc
import os
import sys
from collections.abc import Callable
from contextlib import chdir, suppress
from tempfile import TemporaryDirectory

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich import box
from rich.table import Table

from vgps_ros.core.errors import VgpsError
from vgps_ros.ros_runtime.parameters import DECLARED
from vgps_ros.views.table_console import table_console


def show_help(make_node: Callable[[], Node], name: str) -> None:
    """Prints a node's description and parameters.

    The node is built with its defaults, in a graph that nobody discovers and in an empty folder, so
    that its parameters need not be listed a second time.

    Args:
        make_node: builds the node.
        name: its executable.
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
    table_console().print(table, markup=False, highlight=False)
