# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A short training makes a controller of the half-cheetah, which runs as fast as it is told."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.settings import with_values
from vgps_ros.robot.executed_control import Driver
from vgps_ros.search.judgement import Trial, behaviour
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.solver_processes import SolverProcesses
from vgps_ros.tasks import Task, make_task

RUNNER = str(Path(__file__).parents[2] / "config" / "commanded" / "half_cheetah.yaml")
STEPS = 500  # 10 s
SPEEDS = (0.0, 0.5, 0.8)  # [m/s]
SHORT = {
    "iterations": 6,
    "situations": 12,
    "initial_ddp_iterations": 15,
    "alphas": (0.4, 0.8),
    "renew.share": 0.0,
}


def speeds_of(task: Task, policy: GaussianPolicy) -> np.ndarray:
    """Returns the mean speed at each of `SPEEDS` [m/s]; NaN where a rollout falls."""
    told = np.tile(np.array(SPEEDS)[:, None, None], (1, STEPS, 1))
    starts = np.tile(task.initial_state, (len(told), 1))
    silent = np.zeros((len(told), STEPS, task.dynamics.control_dim))
    time = STEPS * task.dynamics.time_step
    found = behaviour(task, Driver(policy, task.observation), Trial(starts, told, silent), [time])
    return np.where(found.up[:, 0], found.errors[:, 0] + SPEEDS, np.nan)


@pytest.mark.slow
def test_a_short_training_makes_a_runner_of_commanded_speed():
    task = make_task(RUNNER)
    settings = with_values(search_settings(task), SHORT)
    with SolverProcesses(partial(make_task, RUNNER)) as solvers:
        *_, last = search("vgps", task, settings, 0, solvers.optimize_all)
    still, slow, fast = speeds_of(task, last.policy)
    # Of 0.5 and 0.8 m/s seeds 0 to 2 reached 0.34 to 0.42 and 0.66 to 0.73 m/s.
    assert abs(still) < 0.1
    assert 0.15 < slow < 0.6
    assert slow + 0.1 < fast < 1.0
