# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings of the core as ROS parameters: one declaration serves both."""

from collections.abc import Callable
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Setting, settings_of, with_values

Record = TypeVar("Record")

DECLARED: list[tuple[ParameterDescriptor, Any]] = []  # by this process's node, with the defaults

_INTEGER_LIMIT = 2**63 - 1
_FLOAT_LIMIT = 1e300


def declare(
    node: Node,
    setting: Setting,
    *,
    may_change: bool = False,
    also_check: Callable[[Any], object] | None = None,
) -> Any:
    """Declares one parameter and returns its value.

    A value of the wrong type or out of range, at start or later, is refused with a sentence.

    Args:
        node: the node.
        setting: name, default, description and range.
        may_change: whether the parameter may change while the node runs.
        also_check: raises InvalidInputError for a value that is wrong for another reason.

    Raises:
        InvalidInputError: the value that the node was started with is wrong.
    """
    default = list(setting.default) if isinstance(setting.default, tuple) else setting.default
    descriptor = ParameterDescriptor(
        name=setting.name,
        description=f"{setting.description} ({setting.range()})",
        read_only=not may_change,
        integer_range=_range(setting, IntegerRange, int, _INTEGER_LIMIT),
        floating_point_range=_range(setting, FloatingPointRange, float, _FLOAT_LIMIT),
    )
    DECLARED.append((descriptor, default))

    def check(parameters: list[Parameter]) -> SetParametersResult:
        """Refuses a wrong value of this parameter with a sentence."""
        for parameter in parameters:
            if parameter.name == setting.name:
                try:
                    wanted = _from_ros(parameter.value, setting)
                    setting.check(wanted)
                    if also_check:
                        also_check(wanted)
                except InvalidInputError as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)
    try:
        node.declare_parameter(setting.name, default, descriptor)
    except InvalidParameterValueException as error:
        reason = str(error).partition(" Reason: ")[2].removesuffix(f": {setting.name}")
        raise InvalidInputError(reason) from error
    except InvalidParameterTypeException as error:
        raise InvalidInputError(
            f"Parameter {setting.name} must be of type {type(setting.default).__name__}: {error}"
        ) from error
    return value(node, setting)


def value(node: Node, setting: Setting) -> Any:
    """Returns a declared parameter's current value, in the type of the setting."""
    return _from_ros(node.get_parameter(setting.name).value, setting)


def declare_settings(node: Node, record: Record) -> Record:
    """Declares all settings of a record, and returns it with the values of the node's start.

    Raises:
        InvalidInputError: one of them is wrong.
    """
    return with_values(record, {s.name: declare(node, s) for s in settings_of(record)})


def _range(setting: Setting, message: type, kind: type, limit: float) -> list[Any]:
    """The descriptor's range, where the parameter is a number of this kind."""
    if type(setting.default) is not kind or (setting.minimum, setting.maximum) == (None, None):
        return []
    low = -limit if setting.minimum is None else setting.minimum
    high = limit if setting.maximum is None else setting.maximum
    return [message(from_value=kind(low), to_value=kind(high))]


def _from_ros(value: Any, setting: Setting) -> Any:
    return tuple(value) if isinstance(setting.default, tuple) and value is not None else value
