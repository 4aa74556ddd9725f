"""How every node runs and ends."""

import signal
import sys
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node

from vgps_ros.core.errors import VgpsError
from vgps_ros.nodes.responses import keep_responses
from vgps_ros.nodes.service_guard import guard_services

_signals: list[int] = []  # INT and TERM that have come


def is_hurried() -> bool:
    """Returns whether the end was asked for more than once: a clean-up must then not wait."""
    return len(_signals) > 1


def run(make_node: Callable[[], Node], threads: int = 1) -> None:
    """Runs a node until INT or TERM, then destroys it; the process ends with code 0.

    Args:
        make_node: builds the node; a VgpsError from it ends the process with its sentence and
            code 1.
        threads: callbacks that may run at once. One is fastest where messages flow.
    """
    # rclpy ends the spin on INT and TERM, then calls the handler that was there before it: one that
    # only takes note, so that a second signal during the clean-up does no harm.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: _signals.append(number))
    rclpy.init()
    node = executor = None
    try:
        if _signals:
            return
        node = make_node()
        guard_services(node)
        keep_responses(node)
        executor = MultiThreadedExecutor(threads) if threads > 1 else SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except VgpsError as error:
        sys.exit(str(error))
    except (ExternalShutdownException, RuntimeError):
        # A signal may strike between any two calls of rclpy, which then lack their context.
        if rclpy.ok():
            raise
    finally:
        if executor:
            executor.shutdown(timeout_sec=5.0)
        if node:
            node.destroy_node()
        rclpy.try_shutdown()
        # Python's own end gives signals back their defaults, unless they are ignored.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
