# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The targets and weights of a task's cost as parameters that may change while the node runs."""

from collections.abc import Callable

from rclpy.node import Node
from rclpy.parameter import Parameter

from vgps_ros.core.checks import quoted
from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Setting
from vgps_ros.ros_runtime.parameters import declare, value
from vgps_ros.search.adjusted_cost import LARGEST, adjustable

READINGS, TARGETS, WEIGHTS = "cost.readings", "cost.targets", "cost.weights"


def declare_cost(node: Node, cost: FeatureCost, take: Callable[[FeatureCost], object]) -> None:
    """Declares the parameters, where the cost has readings that can be changed.

    Args:
        node: the node.
        cost: the task's cost.
        take: called with the cost, now and after each change.
    """
    changed = adjustable(cost)
    if not changed.names:
        return
    readings = Setting(
        READINGS,
        changed.names,
        "the readings of the cost to which cost.targets and cost.weights belong, given by the task",
    )
    targets = Setting(
        TARGETS,
        tuple(changed.targets.tolist()),
        "their targets, from the next plan on [units of the readings]",
        minimum=-LARGEST,
        maximum=LARGEST,
    )
    weights = Setting(
        WEIGHTS,
        tuple(changed.weights.tolist()),
        "their weights, from the next plan on",
        minimum=0.0,
        maximum=LARGEST,
    )

    def check_readings(given: tuple[str, ...]) -> None:
        if given != changed.names:
            raise InvalidInputError(
                f"{READINGS} is {quoted(list(given))}, but the task has "
                f"{quoted(list(changed.names))}; leave this parameter out."
            )

    declare(node, readings, also_check=check_readings)
    for setting in (targets, weights):
        declare(node, setting, may_change=True, also_check=changed.check_count)

    def adjust(parameters: list[Parameter]) -> None:
        if {p.name for p in parameters} & {TARGETS, WEIGHTS}:
            take(changed(value(node, targets), value(node, weights)))

    node.add_post_set_parameters_callback(adjust)
    take(changed(value(node, targets), value(node, weights)))
