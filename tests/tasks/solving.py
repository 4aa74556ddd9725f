# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A short solve, by which tests see that a task can be optimised."""

from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.trajectory_optimization import OptimizationResult, optimize
from vgps_ros.tasks import Task


def solved(task: Task, iterations: int) -> OptimizationResult:
    """Returns what DDP finds in a few iterations, from the task's own first motion."""
    return optimize(task, first_request(task, 0, iterations))


def remaining_share(result: OptimizationResult) -> float:
    """Returns the cost at the end of a solve, divided by that of the first motion."""
    first = result.iterations[0]
    return result.modified_cost / (first.cost + first.cost_reduction)
