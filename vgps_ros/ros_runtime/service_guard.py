"""Services that rclpy brings along raise on some bad requests, which would end the node."""

from collections.abc import Callable
from functools import partial
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node

from vgps_ros.ros_runtime.rclpy_internals import wrap_callback

_REFUSALS: dict[Any, Callable[[str], Any]] = {
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


def _guarded(
    node: Node, refuse: Callable[[str], Any], callback: Callable[..., Any]
) -> Callable[..., Any]:
    def guarded(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:
            reason = f"The request is refused: {_words(error)}"
            node.get_logger().error(reason)
            return refuse(reason)

    return guarded


def _one_by_one(callback: Callable[..., Any]) -> Callable[..., Any]:
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
    return (ascii(line)[1:-1] if not line.isprintable() else line)[:300] + "."
