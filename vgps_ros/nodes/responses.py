"""Responses that are sent again while discovery has not yet shown the client that waits for them.

A client may find a service, ask and be heard before its own endpoint for the response has been
discovered, on a busy machine seconds before. The middleware then gives the response up after 0.1 s,
of which rclpy only warns, and the client waits for ever.
"""

import threading
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

_DELAYS = (0.25, 0.5, 1.0, 2.0, 4.0)  # before each further try [s]

_lock = threading.Lock()  # what Python does with warnings is a state of the process


def keep_responses(node: Node) -> None:
    """Lets all services that a node has now send a response again that found no client."""
    for service in node.services:
        send = partial(_send, node, service.service_name, service.send_response)
        service.send_response = partial(send, _DELAYS)  # type: ignore[method-assign]


def _send(
    node: Node,
    name: str,
    send: Callable[[Any, Any], None],
    delays: tuple[float, ...],
    response: Any,
    header: Any,
) -> None:
    with _lock, warnings.catch_warnings(record=True) as failures:
        warnings.simplefilter("always")
        send(response, header)
    if not failures:
        return
    if not delays:
        node.get_logger().warn(f"A response of {name} is lost: its client cannot be reached.")
        return

    def send_again() -> None:
        node.destroy_timer(timer)
        _send(node, name, send, delays[1:], response, header)

    timer = node.create_timer(delays[0], send_again, clock=Clock(clock_type=ClockType.STEADY_TIME))
