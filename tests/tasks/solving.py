# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A short solve, by which tests see that a task can be optimised."""

from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.situations import Situation
from vgps_ros.search.trajectory_optimization import OptimizationResult, optimize
from vgps_ros.tasks import Task


def solved(task: Task, iterations: int) -> OptimizationResult:
    """Returns what DDP finds in a few iterations, from the task's own first motion."""
    guess = task.guess(generator(0, Stream.INITIAL_CONTROLS, 0)) if task.guess else None
    request = OptimizationRequest(0, 0, 0, 1.0, iterations, Situation.at_start(task), guess)
    return optimize(task, request)


def remaining_share(result: OptimizationResult) -> float:
    """Returns the cost at the end of a solve, divided by that of the first motion."""
    first = result.iterations[0]
    return result.modified_cost / (first.cost + first.cost_reduction)
