"""Responses that come later than their request's callback ends.

The callback of a service may return a future of its response: it is sent once it is there, and
meanwhile the node does other things.

A response is sent again while discovery has not yet shown the client that waits for it. A client
may find a service, ask and be heard before its own endpoint for the response has been discovered,
on a busy machine seconds before. The middleware then gives the response up after 0.1 s, of which
rclpy only warns, and the client waits for ever.
"""

import threading
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from vgps_ros.ros_runtime.rclpy_internals import wrap_sender
from vgps_ros.ros_runtime.steady_timer import steady_timer

_DELAYS = (0.25, 0.5, 1.0, 2.0, 4.0)  # before each further try [s]

_lock = threading.Lock()  # what Python does with warnings is a state of the process


def answered(response: Trigger.Response, done: bool, yes: str, no: str) -> Trigger.Response:
    """Fills in whether an order was carried out, and the sentence for either case."""
    response.success, response.message = done, yes if done else no
    return response


def keep_responses(node: Node) -> None:
    """Lets all services that a node has now answer later, and again where no client was found."""
    for service in node.services:
        wrap_sender(service, partial(_sender, node, service.service_name))


def _sender(node: Node, name: str, send: Callable[[Any, Any], None]) -> Callable[..., None]:
    """Returns what sends a response in place of rclpy's function."""

    def send_response(response: Any, header: Any, delays: tuple[float, ...] = _DELAYS) -> None:
        if isinstance(response, Future):
            response.add_done_callback(lambda done: send_response(done.result(), header))
            return
        with _lock, warnings.catch_warnings(record=True) as failures:
            warnings.simplefilter("always")
            send(response, header)
        if not failures:
            return
        if not delays:
            sentence = f"A response of {name} is lost: its client cannot be reached."
            node.get_logger().warning(sentence)
            return

        def send_again() -> None:
            node.destroy_timer(timer)
            send_response(response, header, delays[1:])

        timer = steady_timer(node, delays[0], send_again)

    return send_response
