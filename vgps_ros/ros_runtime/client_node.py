# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The node of a program that asks other nodes for something, and ends with their answer."""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TypeVar

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from vgps_ros.ros_runtime.ending import PATIENCE, Ending
from vgps_ros.ros_runtime.exit_timer import exit_after
from vgps_ros.ros_runtime.middleware import choose_middleware

AnyNode = TypeVar("AnyNode", bound=Node)


@contextmanager
def client_node(make_node: Callable[[Ending], AnyNode]) -> Iterator[AnyNode]:
    """Begins ROS 2 and makes a node, which is destroyed after the block.

    INT and TERM are only noted from here on: the node calls `Ending.check` between its calls of
    rclpy.

    Args:
        make_node: builds the node, given what takes note of signals.

    Raises:
        KeyboardInterrupt: INT or TERM came before the node was made.
    """
    ending = Ending(code=1)
    choose_middleware()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = None
    try:
        with suppress(KeyboardInterrupt), ending.interrupting():
            node = make_node(ending)
        if node is None:
            raise KeyboardInterrupt
        yield node
    except KeyboardInterrupt:
        exit_after(PATIENCE, 1)
        raise
    finally:
        if node:
            node.destroy_node()
        rclpy.try_shutdown()
        gc.collect()  # what a node that did not come about still holds
