# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A client of the parameters by which a planner's cost is changed; it waits for no answer."""

from collections.abc import Callable, Sequence

from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

# Parameters of a planner, as the node `mpc` has them.
READINGS, TARGETS, WEIGHTS = "cost.readings", "cost.targets", "cost.weights"

Show = Callable[[Sequence[str], Sequence[float], Sequence[float]], object]


class CostClient:
    """Reads and sets the targets and weights.

    Args:
        node: the node that asks.
        planner: name of the node that has the parameters.
        show: called with the readings, their targets and their weights.
        tell: called with a sentence on each change.
    """

    def __init__(self, node: Node, planner: str, show: Show, tell: Callable[[str], object]):
        self._client = AsyncParameterClient(node, planner)
        self._show, self._tell = show, tell
        self._asked: Future | None = None
        self._changing = 0  # changes whose answer is awaited

    def look(self) -> None:
        """Asks for the values; nothing is shown while there is no planner or no such cost."""
        if not self._client.services_are_ready():
            self._asked = None
            self._show((), (), ())
        elif self._asked is None or self._asked.done():
            self._asked = self._client.get_parameters([READINGS, TARGETS, WEIGHTS])
            self._asked.add_done_callback(self._take)

    def set(self, targets: Sequence[float], weights: Sequence[float]) -> None:
        """Sets all values at once."""
        values = {TARGETS: list(map(float, targets)), WEIGHTS: list(map(float, weights))}
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        self._changing += 1
        self._client.set_parameters_atomically(parameters).add_done_callback(self._answer)

    def _take(self, done: Future) -> None:
        values = [parameter_value_to_python(value) for value in done.result().values]
        if self._changing == 0:  # else the visitor's values are newer
            self._show(*values if all(v is not None for v in values) else ((), (), ()))

    def _answer(self, done: Future) -> None:
        self._changing -= 1
        result = done.result().result
        self._tell("The next plan has the new cost." if result.successful else result.reason)
