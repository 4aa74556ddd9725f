# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Additions to what rclpy does for the services of a node.

- Services that rclpy brings along raise on some bad requests, which would end the node.
- The callback of a service may return a future of its response: it is sent once it is there, and
  meanwhile the node does other things.
- A response is sent again while discovery has not yet shown the client that waits for it. A client
  may find a service, ask and be heard before its own endpoint for the response has been discovered,
  on a busy machine seconds before. The middleware then gives the response up after 0.1 s, of which
  rclpy only warns, and the client waits for ever.
"""

import threading
import warnings
from functools import partial
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from vgps_ros.core.checks import printable
from vgps_ros.ros_runtime.rclpy_internals import Function, wrap_callback, wrap_sender
from vgps_ros.ros_runtime.steady_timer import steady_timer

_DELAYS = (0.25, 0.5, 1.0, 2.0, 4.0)  # before each further try [s]

_lock = threading.Lock()  # what Python does with warnings is a state of the process

_REFUSALS: dict[Any, Function] = {
    SetParameters: lambda reason: SetParameters.Response(results=[_refusal(reason)]),
    SetParametersAtomically: lambda reason: SetParametersAtomically.Response(
        result=_refusal(reason)
    ),
    ChangeState: lambda _: ChangeState.Response(success=False),
}


def guard_services(node: Node) -> None:
    """Lets a node refuse bad requests for parameters and transitions, and go on."""
    for service in node.services:
        if refuse := _REFUSALS.get(service.srv_type):
            wrap_callback(service, partial(_guarded, node, refuse))
        if service.srv_type is SetParameters:
            wrap_callback(service, _one_by_one)


def _guarded(node: Node, refuse: Function, callback: Function) -> Function:
    def guarded(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:
            reason = f"The request is refused: {_words(error)}"
            node.get_logger().error(reason)
            return refuse(reason)

    return guarded


def _one_by_one(callback: Function) -> Function:
    """Sets each parameter of a request on its own, so that a failure refuses this one alone."""

    def set_each(
        request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        for parameter in request.parameters:
            one = SetParameters.Request(parameters=[parameter])
            answer = callback(one, SetParameters.Response())
            response.results = [*response.results, *answer.results]
        return response

    return set_each


def _refusal(reason: str) -> SetParametersResult:
    return SetParametersResult(successful=False, reason=reason)


def _words(error: Exception) -> str:
    """Returns the error's first line as the end of a sentence."""
    line = str(error).partition("\n")[0].strip().rstrip(".")
    return printable(line)[:300] + "."


def answered(done: bool, yes: str, no: str) -> Trigger.Response:
    """Returns the response to an order that was carried out or not, with a sentence for each."""
    return Trigger.Response(success=done, message=yes if done else no)


def keep_responses(node: Node) -> None:
    """Lets all services that a node has now answer later, and again where no client was found."""
    for service in node.services:
        wrap_sender(service, partial(_sender, node, service.service_name))


def _sender(node: Node, name: str, send: Function) -> Function:
    """Returns what sends a response in place of rclpy's function."""

    def send_response(response: Any, header: Any, delays: tuple[float, ...] = _DELAYS) -> None:
        """Sends a response once it is there, and again after each delay [s] until it arrives."""
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
