# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings of the core as ROS parameters, and a check of those that a node was given.

ROS leaves out, without a word, what it cannot use: a misspelt parameter, and a block of a file
whose key is not the node's name.
"""

import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import yaml
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    InvalidTopicNameException,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.validate_topic_name import validate_topic_name

from vgps_ros.core.checks import nearest, quote
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
        setting: the parameter.
        may_change: whether the parameter may change while the node runs.
        also_check: raises InvalidInputError for a value that is wrong for another reason.

    Raises:
        InvalidInputError: the value that the node was started with is wrong.
    """
    default = list(setting.default) if setting.is_list else setting.default
    descriptor = ParameterDescriptor(
        name=setting.name,
        description=setting.description + (f" ({setting.range()})" if setting.range() else ""),
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


def declare_fact(node: Node, setting: Setting) -> None:
    """Declares a list that tells what the task says; another value is refused."""

    def check(given: Any) -> None:
        if given != setting.default:
            raise InvalidInputError(
                f"{setting.name} is {quote(list(given))}, but the task has "
                f"{quote(list(setting.default))}; leave this parameter out."
            )

    declare(node, setting, also_check=check)


def value(node: Node, setting: Setting) -> Any:
    """Returns a declared parameter's current value, in the type of the setting."""
    return _from_ros(node.get_parameter(setting.name).value, setting)


def graph_names(node: Node, setting: Setting) -> list[str]:
    """Returns the names in the graph that a declared parameter lists, each once.

    Raises:
        InvalidInputError: one of them is no name.
    """
    names = [name for name in dict.fromkeys(value(node, setting)) if name]
    name = ""
    try:
        for name in names:
            validate_topic_name(name)
    except InvalidTopicNameException as error:
        raise InvalidInputError(
            f"{setting.name} has {quote(name)}, which is no name in ROS: use letters, digits and "
            "_, with single / between them, as in robot_1."
        ) from error
    return names


def declare_settings(node: Node, record: Record) -> Record:
    """Declares all settings of a record, and returns it with the values of the node's start.

    Raises:
        InvalidInputError: one of them is wrong.
    """
    return with_values(record, {s.name: declare(node, s) for s in settings_of(record)})


def _range(setting: Setting, message: type, kind: type, limit: float) -> list[Any]:
    """The descriptor's range, where the parameter is a number of this kind."""
    schema = setting.schema
    if setting.is_list or setting.kind is not kind or not schema.keys() & {"minimum", "maximum"}:
        return []
    low, high = schema.get("minimum", -limit), schema.get("maximum", limit)
    return [message(from_value=kind(low), to_value=kind(high))]


def _from_ros(value: Any, setting: Setting) -> Any:
    return tuple(value) if setting.is_list and value is not None else value


def check_given_parameters(node: Node) -> None:
    """Checks, once all parameters are declared, that the node was given no others.

    A parameter file's block for all nodes, such as `/**`, may have parameters of other nodes.

    Raises:
        InvalidInputError: the command line, or the node's own block of a file, names another one.
    """
    is_alone = " " not in Path(sys.argv[0]).name  # of several nodes it has all their names
    own = (node.get_name(), "") if is_alone else (node.get_name(),)
    for name in (name for of, name in _given() if of in own):
        if not (node.has_parameter(name) or name.startswith("qos_overrides.")):
            declared = [descriptor.name for descriptor, _ in DECLARED]
            raise InvalidInputError(
                f"{node.get_name()} has no parameter {quote(name)}.{nearest(name, declared)} "
                "Start it with --help alone to see all of them."
            )


def check_common_parameters(nodes: Sequence[Node]) -> None:
    """Checks, once several nodes of one process are built, what was given to all of them.

    Raises:
        InvalidInputError: the command line gives a parameter that none of them has.
    """
    for name in (name for of, name in _given() if not of):
        if not any(node.has_parameter(name) for node in nodes):
            declared = [descriptor.name for descriptor, _ in DECLARED]
            raise InvalidInputError(
                f"None of {', '.join(node.get_name() for node in nodes)} has a parameter "
                f"{quote(name)}.{nearest(name, declared)} Start them with --help alone to see all."
            )


def _given() -> Iterator[tuple[str, str]]:
    """Yields the parameters that this process's arguments give: a node, or '' for any, and a name.

    A node has no namespace here, and may be a pattern.
    """
    arguments = sys.argv[sys.argv.index("--ros-args") :] if "--ros-args" in sys.argv else []
    for flag, argument in pairwise(arguments):
        if flag in ("-p", "--param"):
            target, _, name = argument.partition(":=")[0].rpartition(":")
            yield target.rpartition("/")[2], name
        elif flag == "--params-file":
            for path in _paths(yaml.safe_load(Path(argument).read_text())):
                block, _, name = "\n".join(path).partition("\nros__parameters\n")
                yield block.replace("\n", "/").rpartition("/")[2], name.replace("\n", ".")


def _paths(content: object, *above: str) -> Iterator[tuple[str, ...]]:
    """Yields the keys that lead to each value of a parameter file."""
    if isinstance(content, Mapping):
        for key, inner in content.items():
            yield from _paths(inner, *above, str(key))
    else:
        yield above


class TopicFilter:
    """The topics that the parameters `include` and `exclude` of a node choose.

    Args:
        include: regular expressions, of which at least one must be found in a topic's name.
        exclude: regular expressions, of which none may be found in a topic's name.

    Raises:
        InvalidInputError: an entry is not a regular expression.
    """

    def __init__(self, include: Sequence[str], exclude: Sequence[str]):
        self._include = _patterns("include", include)
        self._exclude = _patterns("exclude", exclude)

    def wants(self, topic: str) -> bool:
        """Returns True if a topic is taken, given its full name."""
        included = any(pattern.search(topic) for pattern in self._include)
        return included and not any(pattern.search(topic) for pattern in self._exclude)


def _patterns(name: str, expressions: Sequence[str]) -> list[re.Pattern[str]]:
    try:
        return [re.compile(expression) for expression in expressions]
    except re.error as error:
        raise InvalidInputError(
            f"{name} is {list(expressions)}, but each entry must be a regular expression: {error}."
        ) from error
