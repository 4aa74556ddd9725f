# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Additions to what rclpy does for the services and the timers of a node."""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.service import Service
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.task import Future
from rclpy.timer import Timer
from type_description_interfaces.srv import GetTypeDescription

from vgps_ros.core.checks import printable
from vgps_ros.core.settings import Setting
from vgps_ros.ros_runtime.qos import CALLS

# rclpy serves these itself, and raises on a type or a transition that does not exist.
SERVICE_INTROSPECTION = Setting(
    "service_introspection",
    "off",
    "what each service publishes of its calls on SERVICE/_service_event",
    kind=Literal["off", "metadata", "contents"],
)

_GUARDED = (SetParameters, SetParametersAtomically, ChangeState)


def guard_services(node: Node) -> None:
    """Lets a node refuse bad requests for parameters and transitions, which would end it.

    Its services publish events where its parameter `service_introspection` says so.

    A read-only parameter may be set to the value that it has: `ros2 param load` does so with what
    `ros2 param dump` of the same node wrote.
    """
    for service in node.services:
        if service.srv_type in _GUARDED:
            service.callback = partial(_answer_or_refuse, node, service.callback)
    name = SERVICE_INTROSPECTION.name
    shown = node.get_parameter(name).value if node.has_parameter(name) else "off"
    if shown != "off":
        state = getattr(ServiceIntrospectionState, shown.upper())
        for service in node.services:
            if service.srv_type is not GetTypeDescription:  # which rcl answers by itself
                service.configure_introspection(node.get_clock(), CALLS, state)


def _answer_or_refuse(node: Node, callback: Any, request: Any, response: Any) -> Any:
    given = [] if isinstance(response, ChangeState.Response) else list(request.parameters)
    try:
        stand = [_stands(node, parameter) for parameter in given]
        if given:
            request.parameters = [p for p, stands in zip(given, stand, strict=True) if not stands]
        response = callback(request, response)
        if isinstance(response, SetParameters.Response):
            results, stood = iter(response.results), SetParametersResult(successful=True)
            response.results = [stood if stands else next(results) for stands in stand]
        return response
    except Exception as error:
        line = printable(str(error).partition("\n")[0])[:300]
        reason = f"The request is refused: {line.strip().rstrip('.')}."
        node.get_logger().error(reason)
    refusal = SetParametersResult(successful=False, reason=reason)
    if isinstance(response, SetParameters.Response):
        response.results = [refusal] * len(given)
    elif isinstance(response, SetParametersAtomically.Response):
        response.result = refusal
    return response  # of a transition: without success


def _stands(node: Node, given: ParameterMsg) -> bool:
    """Returns whether a read-only parameter has this value already."""
    if not (node.has_parameter(given.name) and node.describe_parameter(given.name).read_only):
        return False
    now = node.get_parameter(given.name)
    # `ros2 param load` takes 1.0e-07, as it stands in the file, for text.
    return given.value == now.get_parameter_value() or given.value.string_value == str(now.value)


def answer_later(service: Service) -> Service:
    """Lets a service's callback return a Future of its response, which is sent once it is there.

    Meanwhile the node does other things. rclpy's way, a coroutine, fails in the events executor.
    """
    send = service.send_response

    def send_response(response: Any, header: Any) -> None:
        if isinstance(response, Future):
            response.add_done_callback(lambda done: send(done.result(), header))
        else:
            send(response, header)

    service.send_response = send_response  # type: ignore[method-assign]
    return service


def steady_timer(node: Node, period: float, callback: Callable[[], object]) -> Timer:
    """Calls back once a period [s] by the wall clock, whatever the system's time does.

    Simulated time may stand still just when something is wrong.
    """
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))
