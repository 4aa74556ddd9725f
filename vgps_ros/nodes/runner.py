"""How every node runs and ends."""

import gc
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import rclpy
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.node import Node

from vgps_ros.core.errors import VgpsError
from vgps_ros.nodes.exit_timer import exit_after
from vgps_ros.nodes.responses import keep_responses
from vgps_ros.nodes.service_guard import guard_services

AnyNode = TypeVar("AnyNode", bound=Node)

# In which callbacks must notice the end, and the middleware close: it was seen to wait for its own
# threads for ever [s].
_PATIENCE = 1.5

# What rclpy raises where a signal, which ends its context, strikes between any two of its calls.
_LACKS_CONTEXT = (ExternalShutdownException, RuntimeError, ValueError)

_ENDING = (signal.SIGINT, signal.SIGTERM)
_signals: list[int] = []  # those of them that have come


class _ThreadedExecutor(MultiThreadedExecutor):
    """Waits for its callbacks, and ends its threads, which rclpy leaves to the end of Python."""

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Ends the executor; returns whether its callbacks have ended."""
        ended = super().shutdown(timeout_sec)
        self._executor.shutdown()
        return ended


def is_hurried() -> bool:
    """Returns whether the end was asked for more than once: a clean-up must then not wait."""
    return len(_signals) > 1


def run(
    make_node: Callable[[], AnyNode],
    threads: int = 1,
    close: Callable[[AnyNode], None] = lambda _: None,
) -> int:
    """Runs a node until INT or TERM, then destroys it.

    Args:
        make_node: builds the node; a VgpsError from it, or from a callback, ends the node with its
            sentence.
        threads: callbacks that may run at once. One is fastest where messages flow.
        close: completes what the node has begun; of one thread's callbacks none runs any more.

    Returns:
        The process's exit code.
    """
    # rclpy ends the spin on INT and TERM, then calls the handler that was there before it: one that
    # only takes note, so that a second signal during the clean-up does no harm.
    for number in _ENDING:
        signal.signal(number, lambda number, _: _signals.append(number))
    with _delayed_signals():
        rclpy.init()
        executor = _ThreadedExecutor(threads) if threads > 1 else SingleThreadedExecutor()
    node, code = None, 0
    try:
        if not _signals:
            node = make_node()
            _spin(node, executor, close)
    except VgpsError as error:
        print(error, file=sys.stderr)
        code = 1
    except Exception as error:
        if rclpy.ok() or not isinstance(error, _LACKS_CONTEXT):
            traceback.print_exc()
            code = 1
    exit_after(_PATIENCE, code)
    executor.shutdown()
    if node:
        node.destroy_node()
    del node, executor
    gc.collect()  # what a node that did not come about, or one with a lifecycle, still holds
    rclpy.try_shutdown()
    return code


def _spin(node: AnyNode, executor: Executor, close: Callable[[AnyNode], None]) -> None:
    try:
        guard_services(node)
        keep_responses(node)
        executor.add_node(node)
        executor.spin()
    finally:
        close(node)


@contextmanager
def _delayed_signals() -> Iterator[None]:
    """Delays INT and TERM: rclpy's executor prints a traceback where one strikes in its making."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
