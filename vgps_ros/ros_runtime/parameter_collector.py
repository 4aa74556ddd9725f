# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Gathers the parameters of every node of the graph, as a parameter file has them."""

import time
from functools import partial
from typing import Any

import yaml
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rclpy.task import Future

_ANSWER_TIMEOUT = 5.0  # after which a node is asked again [s]
_MOST_NODES = 200  # whose parameters are kept
_LONGEST = 100_000  # value that is kept, as Python writes it


class ParameterCollector:
    """Asks each node once, and follows what changes; a node that has left keeps its entry.

    Attributes:
        is_changed: whether something is new since the last `text`.
    """

    def __init__(self, node: Node):
        self.is_changed = False
        self._node = node
        self._values: dict[str, dict[str, Any]] = {}
        self._asked: dict[str, float] = {}  # nodes, and when, by the steady clock [s]
        node.create_subscription(
            ParameterEvent, "/parameter_events", self._follow, qos_profile_parameter_events
        )

    def look(self) -> None:
        """Asks nodes that are new; call it now and then."""
        names = {
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
        }
        # One that comes back is asked again, and one whose answer is late: it may have been lost.
        late = time.monotonic() - _ANSWER_TIMEOUT
        self._asked = {
            name: when
            for name, when in self._asked.items()
            if name in names and (name in self._values or when > late)
        }
        new = sorted(names - self._asked.keys())
        services = {name for name, _ in self._node.get_service_names_and_types()} if new else set()
        for name in new:
            has_place = len(self._asked.keys() | self._values.keys()) < _MOST_NODES
            if has_place and f"{name}/get_parameters" in services:
                self._asked[name] = time.monotonic()
                client = self._node.create_client(ListParameters, f"{name}/list_parameters")
                future = client.call_async(ListParameters.Request())
                future.add_done_callback(partial(self._take_names, name, client))

    def text(self) -> str:
        """Returns what is known as YAML that `--params-file` takes."""
        self.is_changed = False
        return yaml.safe_dump(
            {name: {"ros__parameters": values} for name, values in sorted(self._values.items())}
        )

    def _take_names(self, node: str, client: Client, future: Future) -> None:
        self._node.destroy_client(client)
        names = future.result().result.names
        values = self._node.create_client(GetParameters, f"{node}/get_parameters")
        answer = values.call_async(GetParameters.Request(names=names))
        answer.add_done_callback(partial(self._take_values, node, list(names), values))

    def _take_values(self, node: str, names: list[str], client: Client, future: Future) -> None:
        self._node.destroy_client(client)
        # A node that has parameters undeclared meanwhile answers with fewer values.
        for name, value in zip(names, future.result().values, strict=False):
            self._set(node, name, value)

    def _follow(self, event: ParameterEvent) -> None:
        if event.node in self._values:
            for parameter in (*event.new_parameters, *event.changed_parameters):
                self._set(event.node, parameter.name, parameter.value)

    def _set(self, node: str, name: str, message: Any) -> None:
        try:
            value = parameter_value_to_python(message)
        except RuntimeError:  # of a type that does not exist
            return
        value = value.tolist() if hasattr(value, "tolist") else value
        if len(repr(value)) > _LONGEST:
            return
        known = self._values.setdefault(node, {})
        if name not in known or known[name] != value:
            known[name] = value
            self.is_changed = True
