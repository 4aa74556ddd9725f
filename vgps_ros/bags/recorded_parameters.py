# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The parameters of a bag's nodes: those that its recorder wrote down, and what the nodes said."""

from typing import Any

from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.timeline import Timeline
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.plain_yaml import read_yaml

_FILE = "parameters.yaml"
# The field of a ParameterValue that holds the value, by its type.
_FIELDS = (
    *("bool_value", "integer_value", "double_value", "string_value", "byte_array_value"),
    *("bool_array_value", "integer_array_value", "double_array_value", "string_array_value"),
)


class RecordedParameters:
    """Parameters of the nodes of the bag's robot.

    Args:
        bag: the bag; one without parameters.yaml has none.

    Attributes:
        nodes: the parameters in parameters.yaml, by the full names of the nodes.

    Raises:
        InvalidInputError: parameters.yaml does not hold parameters.
    """

    def __init__(self, bag: BagReader):
        nodes = read_yaml(bag.attachments().get(_FILE, ""), _FILE) or {}
        try:
            self.nodes: dict[str, dict[str, Any]] = {
                name: dict(nodes[name]["ros__parameters"]) for name in bag.of_robot(nodes)
            }
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InvalidInputError(f"{_FILE} does not hold nodes' parameters.") from error
        self._said: dict[tuple[str, str], Timeline] = {}
        topic = bag.filled_topics.get("parameter_events")
        for received, message in bag.decoded(topic) if topic else ():
            for parameter in (*message.new_parameters, *message.changed_parameters):
                said = self._said.setdefault((message.node, parameter.name), Timeline())
                said.add(received, _value(parameter.value))

    def having(self, *names: str) -> tuple[str, dict[str, Any]]:
        """Returns the first node that has these parameters, and all that it has; else nothing."""
        found = ((node, own) for node, own in self.nodes.items() if set(names) <= set(own))
        return next(found, ("", {}))

    def around(self, node: str, name: str, time: int) -> list[Any]:
        """Returns the values that a parameter may have had at a time [ns], the likeliest first.

        Before the node first spoke of it, it may have had any that is known.
        """
        said = self._said.get((node, name), Timeline())
        own = self.nodes.get(node, {})
        return said.around(time) or [*said.values, *([own[name]] if name in own else [])]

    def contradictions(self) -> list[str]:
        """Returns a sentence on each parameter in parameters.yaml that its node set otherwise."""
        return [
            f"{_FILE} has {own[name]!r} as {name} of {node}, which said {said.values[-1]!r}"
            for (node, name), said in self._said.items()
            if name in (own := self.nodes.get(node, {})) and own[name] != said.values[-1]
        ]


def _value(message: Any) -> Any:
    """Returns the value in a message; None if it has a type that does not exist."""
    if not 1 <= message.type <= len(_FIELDS):
        return None
    value = getattr(message, _FIELDS[message.type - 1])
    return value.tolist() if hasattr(value, "tolist") else value
