# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""INT and TERM end a node in two steps: its executor stops, and a moment later its context ends.

In between the node closes while it can still publish. A thread of its own reads the signal, since
Python's handlers run only between two steps of the main thread, which may wait in the middleware.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import ClassVar

import rclpy
from rclpy.executors import Executor
from rclpy.node import Node

from vgps_ros.core.errors import VgpsError

_MOMENT = 0.5  # for a callback to return and the node to close, before the context ends [s]
_LONGEST_TURN = 1.0  # of the events executor, while there is nothing to do [s]


class Ending:
    """Takes note that the end of this process is wanted; its main thread makes one of these.

    Attributes:
        failure: why the node must end, in a sentence.
        executor: what spins; None as long as nothing does.
        is_wanted: whether INT or TERM has come, or a callback has failed.
    """

    failure: ClassVar[VgpsError | None] = None

    def __init__(self) -> None:
        self.executor: Executor | None = None
        self.is_wanted = False
        self._signals = 0
        self._may_interrupt = False
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)
        signal.set_wakeup_fd(writer)
        threading.Thread(target=self._follow, args=(reader,), daemon=True).start()

    def is_hurried(self) -> bool:
        """Returns whether the user has sent a second signal, so that closing must not wait."""
        return self._signals > 1

    def spin(self, node: Node, executor: Executor) -> None:
        """Runs a node's callbacks until the end is wanted, or the context has ended.

        Raises:
            VgpsError: `end_with` was called with it.
        """
        executor.add_node(node)
        # Without a time-out rclpy's events executor, which is none of its Executors, takes a core
        # and never comes back; the others would make a timer for each turn.
        timeout = None if isinstance(executor, Executor) else _LONGEST_TURN
        while rclpy.ok() and not self.is_wanted and not Ending.failure:
            executor.spin_once(timeout_sec=timeout)
        failure, Ending.failure = Ending.failure, None  # or it would keep the node alive
        if failure:
            raise failure

    @contextmanager
    def interrupting(self) -> Iterator[None]:
        """Makes the first signal raise KeyboardInterrupt in a block that may take long."""
        self._may_interrupt = True
        try:
            if self.is_wanted:
                raise KeyboardInterrupt
            yield
        finally:
            self._may_interrupt = False

    def _handle(self, _number: int, _frame: FrameType | None) -> None:
        self.is_wanted = True
        self._signals += 1
        if self._may_interrupt:
            self._may_interrupt = False
            raise KeyboardInterrupt

    def _follow(self, reader: int) -> None:
        os.read(reader, 1)
        self.is_wanted = True
        if self.executor:
            self.executor.create_task(lambda: None)  # wakes it
        time.sleep(_MOMENT)
        while self._may_interrupt:  # it came just before a call that waits, which sleeps on
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
            time.sleep(_MOMENT)
        if self.executor:
            rclpy.try_shutdown()


def end_with(failure: VgpsError) -> None:
    """Ends this process's node with an error, from within a callback.

    The callback cannot raise the error: the events executor would log it as a fault of the code.
    """
    Ending.failure = failure
