# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Drives a simulated robot by plans whose making takes time.

A control step lasts as long as it does on a robot, and the planner works all that time: it plans
again and again from the newest state, and a plan drives from the first control step after its end.
The module needs NumPy alone, since peers run it in environments of their own.
"""

import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np


class Robot(Protocol):
    """A robot, simulated."""

    @property
    def state(self) -> Any:
        """The state, shape (n_x,)."""

    def advance(self, control: Any) -> None:
        """Holds a control (n_u,) for one control step."""


class Law(Protocol):
    """The torques that a plan gives."""

    def __call__(self, state: Any, step: int) -> Any:
        """Returns the control in a state (n_x,) at a control step, shape (n_u,)."""


class Planner(Protocol):
    """Plans again and again; each plan begins with the one before it."""

    def plan(self, state: Any, step: int) -> Law:
        """Returns the law of the plan that begins with a state at a control step."""


@dataclass(frozen=True)
class Drive:
    """What was driven: states (T+1, n_x), controls (T, n_u), and the plans that were made."""

    states: Any
    controls: Any
    plans: int


def drive(robot: Robot, planner: Planner, steps: int, period: float, preparation: float) -> Drive:
    """Drives a robot.

    Args:
        robot: the robot.
        planner: makes the plans.
        steps: T, number of control steps.
        period: wall time of a control step [s].
        preparation: wall time for which plans are made before the first step [s]; one at least is.
    """
    states, controls = [np.array(robot.state)], []
    free, plans, law = 0.0, 0, None
    while law is None or free < preparation:
        took, law = _timed(planner, robot.state, 0)
        free, plans = free + took, plans + 1
    free, waiting = 0.0, [(0.0, law)]
    for step in range(steps):
        now = step * period
        ready = [law for end, law in waiting if end <= now]
        law = ready[-1] if ready else law
        waiting = waiting[len(ready) :]
        free = max(free, now)
        while free < now + period:
            took, found = _timed(planner, robot.state, step)
            free, plans = free + took, plans + 1
            waiting.append((free, found))
        controls.append(np.array(law(robot.state, step)))
        robot.advance(controls[-1])
        states.append(np.array(robot.state))
    return Drive(np.array(states), np.array(controls), plans)


def _timed(planner: Planner, state: Any, step: int) -> tuple[float, Law]:
    began = time.perf_counter()
    law = planner.plan(state, step)
    return time.perf_counter() - began, law
