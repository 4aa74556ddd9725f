# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The walker's task: its file, and the gait of the SIMBICON controller as the first motion."""

from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path

from vgps_ros.core.records import Array, Trajectory
from vgps_ros.tasks.builder import load_task
from vgps_ros.tasks.first_motion import FunctionMotion, TrackedMotion
from vgps_ros.tasks.task import Task
from vgps_ros.tasks.walker.simbicon import GAIT, Simbicon, go_on, standing

WARM_UP = 1000  # steps after which the gait is steady


def task() -> Task:
    """Returns the walker's task."""
    first = demonstration()
    begin = TrackedMotion(first, FunctionMotion(lambda _, start, steps: walking_from(start, steps)))
    return replace(plain_task(), begin=begin, initial_state=first.states[0])


def plain_task() -> Task:
    """Returns the task as its file has it, without a motion to begin with."""
    return load_task(Path(__file__).with_name("task.yaml"), "walker")


@cache
def demonstration() -> Trajectory:
    """Returns steady walking by the SIMBICON controller, over horizon and lookahead."""
    walker, start = plain_task(), _steady()[1]
    walking = walking_from(start, walker.planned_horizon)
    walking.states[:, 0] -= start[0]
    return walking


def walking_from(start: Array, steps: int) -> Trajectory:
    """Returns walking by the same controller from a start near the demonstration's."""
    return go_on(plain_task().dynamics, copy(_steady()[0]), start, steps)


@cache
def _steady() -> tuple[Simbicon, Array]:
    """The controller and the state at which the demonstration begins."""
    dynamics = plain_task().dynamics
    controller = Simbicon(GAIT, dynamics.time_step)
    walking = go_on(dynamics, controller, standing(), WARM_UP)
    return controller, walking.states[-1]
