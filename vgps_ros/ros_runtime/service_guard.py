"""Services that rclpy brings along raise on some bad requests, which would end the node."""

from collections.abc import Callable
from functools import partial
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node

from vgps_ros.ros_runtime.rclpy_internals import wrap_callback


def guard_services(node: Node) -> None:
    """Lets a node refuse bad requests for parameters and transitions, and go on."""
    guards = {
        SetParameters: _set_each,
        SetParametersAtomically: _set_together,
        ChangeState: _change_state,
    }
    for service in node.services:
        if service.srv_type in guards:
            wrap_callback(service, partial(guards[service.srv_type], node))


def _set_each(node: Node, callback: Callable[..., Any]) -> Callable[..., Any]:
    """Each parameter is set or refused on its own."""

    def guarded(
        request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        """Sets one after the other; a failure refuses its own alone."""
        for parameter in request.parameters:
            one = SetParameters.Request(parameters=[parameter])
            try:
                results = callback(one, SetParameters.Response()).results
            except Exception as error:
                results = [_refused(node, error)]
            response.results = [*response.results, *results]
        return response

    return guarded


def _set_together(node: Node, callback: Callable[..., Any]) -> Callable[..., Any]:
    def guarded(
        request: SetParametersAtomically.Request, response: SetParametersAtomically.Response
    ) -> SetParametersAtomically.Response:
        try:
            return callback(request, response)
        except Exception as error:
            response.result = _refused(node, error)
            return response

    return guarded


def _change_state(node: Node, callback: Callable[..., Any]) -> Callable[..., Any]:
    def guarded(
        request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            return callback(request, response)
        except Exception as error:
            node.get_logger().error(f"Refused a transition: {_words(error)}")
            return ChangeState.Response(success=False)

    return guarded


def _refused(node: Node, error: Exception) -> SetParametersResult:
    reason = f"The parameter cannot be set: {_words(error)}"
    node.get_logger().error(reason)
    return SetParametersResult(successful=False, reason=reason)


def _words(error: Exception) -> str:
    """Returns the error's first line as the end of a sentence."""
    line = str(error).partition("\n")[0].strip().rstrip(".")
    return (ascii(line)[1:-1] if not line.isprintable() else line)[:300] + "."
