# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""All that this project needs of rclpy beyond its public interface.

- `Service.callback` and `Service.send_response` are replaced. The services for parameters and
  transitions are made by rclpy itself, with callbacks that some bad requests make raise; and only
  the sending of a response can be put off. A coroutine as callback is the public way to answer
  later, but the events executor does not await it: it fails with a TypeError.
- The events executor is still in `rclpy.experimental`. For each message the public executors ask
  for all services, timers and topics of a node, which takes three times as long.
- `Subscription.handle` takes messages outside of an executor, which tells how many there were.
- `MultiThreadedExecutor._executor` is the pool of threads, which rclpy leaves to the end of Python.
  A thread that still holds a node keeps it from saying goodbye to the others.

tests/nodes/test_private_names.py tells when a release of rclpy no longer works in this way.
"""

import time
from collections.abc import Callable
from typing import Any

from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.service import Service
from rclpy.subscription import Subscription

Function = Callable[..., Any]


def wrap_callback(service: Service, wrap: Callable[[Function], Function]) -> None:
    """Puts a function of the service's callback in the callback's place."""
    service.callback = wrap(service.callback)


def wrap_sender(service: Service, wrap: Callable[[Function], Function]) -> None:
    """Puts a function of what sends the service's responses in its place."""
    service.send_response = wrap(service.send_response)  # type: ignore[method-assign]


def discard_unread(subscription: Subscription, end: float) -> int:
    """Takes the messages that wait, until a time of the steady clock [s]; returns their number."""
    count, handle = 0, subscription.handle
    with handle:
        while time.monotonic() < end and handle.take_message(subscription.msg_type, True):
            count += 1
    return count


class ThreadedExecutor(MultiThreadedExecutor):
    """An executor of several threads, which ends them when it is shut down."""

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Ends the executor; returns whether its callbacks have ended."""
        ended = super().shutdown(timeout_sec)
        self._executor.shutdown()
        return ended


def streaming_executor() -> Executor:
    """Returns the executor that takes least time for each message.

    It has one thread, and takes no guard conditions and no callbacks with a message's info.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:  # in the first releases of Jazzy
        return SingleThreadedExecutor()
    return EventsExecutor()
