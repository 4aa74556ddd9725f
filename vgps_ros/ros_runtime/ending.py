# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""INT and TERM end a node in two steps: its executor stops, and a moment later its context ends.

In between the node closes while it can still publish. A thread of its own reads the signal, since
Python's handlers run only between two steps of the main thread, which may wait in the middleware.

No process leaves signals to rclpy, whose handlers end the context at once, and nothing is raised
within rclpy: what it has half made then cannot be taken apart, and does not say goodbye to others.
"""

import os
import signal
import sys
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
from vgps_ros.ros_runtime.exit_timer import exit_after
from vgps_ros.ros_runtime.interruptible import LATER, is_raised, may_raise, tell_lost

# Callbacks must return and the middleware must close within this time: of 387 nodes that were ended
# without a limit, one never ended; the cause is not known [s].
PATIENCE = 1.5
_MOMENT = 0.5  # for a callback to return and the node to close, before the context ends [s]
_LONGEST_START = 3.5  # after a signal, of a start that nothing interrupts [s]
_LONGEST_TURN = 1.0  # of the events executor, while there is nothing to do [s]


class Ending:
    """Takes note that the end of this process is wanted; its main thread makes one of these.

    Args:
        code: exit code of a process whose start hangs and is cut off.

    Attributes:
        failure: why the node must end, in a sentence.
        executor: what spins; None as long as nothing does.
        is_wanted: whether INT or TERM has come, or a callback has failed.
    """

    failure: ClassVar[VgpsError | None] = None

    def __init__(self, code: int = 0) -> None:
        self._code = code
        self.executor: Executor | None = None
        self.is_wanted = False
        self._signals = 0
        self._may_interrupt = False
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
            signal.signal(number, self._handle)
        signal.set_wakeup_fd(writer)
        sys.unraisablehook = tell_lost
        threading.Thread(target=self._follow, args=(reader,), daemon=True).start()

    def is_hurried(self) -> bool:
        """Returns whether the user has sent a second signal, so that closing must not wait."""
        return self._signals > 1

    def check(self) -> None:
        """Raises KeyboardInterrupt if the end is wanted."""
        if self.is_wanted:
            raise KeyboardInterrupt

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
        """Makes the first signal raise KeyboardInterrupt in a block that may take long.

        Within rclpy and within an import it is raised once that is over. If it is not over soon,
        the process is cut off.
        """
        self._may_interrupt = True
        try:
            self.check()
            yield
        finally:
            self._may_interrupt = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.is_wanted = True
        self._signals += number != signal.SIGALRM  # which repeats one
        if self._may_interrupt and may_raise(frame) and not is_raised():
            raise KeyboardInterrupt

    def _follow(self, reader: int) -> None:
        os.read(reader, 1)
        self.is_wanted = True
        if self.executor:
            self.executor.create_task(lambda: None)  # wakes it
        end = time.monotonic() + _LONGEST_START
        while self._may_interrupt:  # it came within rclpy, before a call that waits on, or was lost
            if time.monotonic() > end:
                exit_after(LATER, self._code)
            time.sleep(LATER)
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGALRM)
        time.sleep(_MOMENT)
        if self.executor:
            rclpy.try_shutdown()


def end_with(failure: VgpsError) -> None:
    """Ends this process's node with an error, from within a callback.

    The callback cannot raise the error: the events executor would log it as a fault of the code.
    """
    Ending.failure = failure
