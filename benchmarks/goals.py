# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a learner of locomotion must reach, however it learns, and how it has fared."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from benchmarks.problems import optimize
from vgps_ros.core.records import Trajectory
from vgps_ros.simulation.dynamics import ControlLaw
from vgps_ros.tasks import Task

_DDP_ITERATIONS = 200
_COST_FACTOR = 1.05  # that the swimmer's policy may cost more than DDP's solution
_WALKING_TIME = 10.0  # [s]
_WALKING_SPEED = 0.5  # below it the walker stands rather than walks, mean [m/s]


@dataclass(frozen=True)
class Goal:
    """A figure of the rollout from x_1 without noise, which must not exceed a bound.

    Attributes:
        name: what it is to reach it.
        horizon: steps of the rollout.
        figure: of a rollout; less is better.
        bound: what it must not exceed.
    """

    name: str
    horizon: int
    figure: Callable[[Trajectory], float]
    bound: float

    def measure(self, task: Task, control_law: ControlLaw) -> float:
        """Returns the figure of a policy; inf where its rollout diverges."""
        rollout = task.dynamics.rollout(task.initial_state, control_law, self.horizon)
        return self.figure(rollout) if np.isfinite(rollout.states).all() else float("inf")


def cost_goal(task: Task) -> Goal:
    """As good as DDP: the task's cost, at most 5 % above that of its 200th iteration."""
    bound = _COST_FACTOR * optimize(task, _DDP_ITERATIONS).cost
    return Goal("a cost 5 % above DDP's", task.horizon, task.trajectory_cost, bound)


def walking_goal(task: Task) -> Goal:
    """Ten seconds of walking: seconds that it lacks until a fall, or until it is fast enough."""
    horizon = round(_WALKING_TIME / task.dynamics.time_step)

    def lacking(rollout: Trajectory) -> float:
        fallen = task.fallen(rollout.states)
        steps = int(fallen.argmax()) if fallen.any() else horizon
        distance = float(task.distance(rollout.states[0], rollout.states[steps]))
        return _WALKING_TIME - min(steps * task.dynamics.time_step, distance / _WALKING_SPEED)

    return Goal("ten seconds of walking", horizon, lacking, 1e-9)


@dataclass(frozen=True)
class Outcome:
    """How a learner has fared.

    Attributes:
        reached: whether it came to the goal.
        seconds: wall time until then, or until it was given up, without the looks at it.
        simulator_steps: simulator steps done meanwhile, those of finite differences included.
        policy_steps: those of them that an unfinished policy drove.
        best: the best figure seen.
    """

    reached: bool
    seconds: float
    simulator_steps: int
    policy_steps: int
    best: float


class Stopwatch:
    """Wall time, less that of the looks."""

    def __init__(self) -> None:
        self._began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """What has passed [s]."""
        return time.perf_counter() - self._began

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Leaves out what passes meanwhile."""
        before = self.seconds
        yield
        self._began = time.perf_counter() - before
