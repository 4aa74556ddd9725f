# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Plans that come late by a fixed time, under pushes: `python -m benchmarks.latency TASK --help`.

The closed loop is in process and in simulated time, so that its result depends neither on how fast
the machine is nor on what else it does: each plan drives from so many control steps after the state
from which it was made, and the next one is made from the state at that time. As in
`benchmarks.pushes`, the velocity of the robot's base changes at each push, and a robot that falls
starts anew. With a latency of -1 the policy drives alone.
"""

import argparse
import json
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.pushed import add_arguments, push
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.search.mpc import MpcSettings, Plan, Planner
from vgps_ros.storage.run_folder import load_policy
from vgps_ros.tasks import make_task


class LatePlans:
    """Feedback along plans that take a fixed number of control steps each."""

    def __init__(self, planner: Planner, latency: int, policy: GaussianPolicy | None):
        self._planner, self._latency, self._policy = planner, latency, policy
        self._first = planner.first_plan()
        self._under_way: tuple[int, Plan | None] = (0, None)
        self.begin(0)

    def begin(self, step: int) -> None:
        """Starts anew, as after a fall."""
        self._plan = replace(self._first, start=step)
        self._under_way = (step, None)

    def control(self, state: Any, step: int) -> Any:
        """Returns the torques in a state."""
        due, plan = self._under_way
        if step >= due:
            self._plan = plan or self._plan
            try:
                found = self._planner.next_plan(self._plan, state, step, self._policy)
            except DivergenceError:
                found = None
            self._under_way = (step + self._latency, found)
            if not self._latency:
                self._plan, self._under_way = found or self._plan, (step + 1, None)
        if step - self._plan.start > self._planner.age_limit:
            return np.zeros_like(self._plan.trajectory.controls[0])
        return self._planner.control(self._plan, state, step)


def main() -> None:
    """Runs one closed loop, and prints its figures as a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task")
    parser.add_argument("--latency", type=int, default=0, help="of each plan, in control steps")
    add_arguments(parser)
    given = parser.parse_args()
    task, rng = make_task(given.task), np.random.default_rng(0)
    policy = load_policy(given.policy)[0] if given.policy else None
    dynamics, x = task.dynamics, task.initial_state
    plans = None
    if given.latency >= 0:
        settings = MpcSettings(horizon=given.horizon, ddp=task.optimizer.ddp)
        plans = LatePlans(Planner(task, settings), given.latency, policy)
    costs, falls, period = [], [], dynamics.time_step
    for step in range(round(given.seconds / period)):
        if plans:
            u = plans.control(x, step)
        else:
            assert policy is not None
            u = np.clip(policy.mean(task.observation(x)), *dynamics.control_limits)
        costs.append(float(task.cost(x[None], u[None])[0]))
        x = dynamics.step(x, u)
        if given.push and (step + 1) % round(given.every / period) == 0:
            x = push(task, x, given.push, rng)
        if not np.abs(x).max() < 1e4 or task.fallen(x[None])[0]:
            falls.append((step + 1) * period)
            x = task.initial_state
            if plans:
                plans.begin(step + 1)
    figures = {
        "falls": len(falls),
        "first fall [s]": falls[0] if falls else None,
        "median cost a step": float(np.median(costs)),
        "mean cost a step": float(np.mean(costs)),
    }
    print(json.dumps({**vars(given), "policy": bool(given.policy)} | figures), flush=True)


if __name__ == "__main__":
    main()
