# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A short training makes a controller of the quadruped: it stays up, and does what it is told."""

from dataclasses import replace
from functools import partial

import numpy as np

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.settings import with_values
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.solver_processes import SolverProcesses
from vgps_ros.tasks import Task, make_task

STEPS = 500  # 10 s
# Nothing commanded; ahead, fast ahead, back; left; turning; both.
COMMANDS = (
    (0.0, 0.0, 0.0),
    (0.4, 0.0, 0.0),
    (0.8, 0.0, 0.0),
    (-0.3, 0.0, 0.0),
    (0.0, 0.2, 0.0),
    (0.0, 0.0, 0.6),
    (0.4, 0.0, -0.5),
)
STARTS = 4  # for each of them

SHORT = {
    "iterations": 4,
    "situations": 16,
    "initial_ddp_iterations": 15,
    "renew.share": 0.0,
}


def judged(task: Task, policy: GaussianPolicy) -> tuple[float, np.ndarray]:
    """Returns the share of the rollouts that stay up, and the rms error of each command then."""
    rng, told = np.random.default_rng(7), np.repeat(np.array(COMMANDS), STARTS, axis=0)
    space = task.dynamics.space
    spread = task.initial_std * rng.standard_normal((len(told), space.tangent_dim))
    contexts = np.array([task.signals.held(each, STEPS) for each in told])
    silent = np.zeros((len(told), STEPS, task.dynamics.control_dim))
    states, controls = task.dynamics.execute(
        policy,
        task.observation.within(contexts),
        space.add(task.initial_state, spread),
        silent,
    )
    up = task.survived(states)
    if not up.any():
        return 0.0, np.full(3, np.inf)
    names = task.cost.features.names
    columns = [names.index(name) for name in ("velocity/x", "velocity/y", "turning/z")]
    late = slice(STEPS // 2, STEPS)
    done = task.cost.features(states[up, :-1][:, late], controls[up][:, late])[..., columns]
    errors = done.mean(axis=1) - told[up]
    return float(up.mean()), np.sqrt((errors**2).mean(axis=0))


def test_a_short_training_makes_a_controller_of_the_quadruped():
    task = make_task("quadruped")
    settings = with_values(search_settings(task), SHORT)
    with SolverProcesses(partial(make_task, "quadruped")) as solvers:
        *_, last = search("vgps", task, settings, 0, solvers.optimize_all)
    up, errors = judged(task, last.policy)
    # Seeds 0 to 2 stayed up in all rollouts, with errors of at most 0.10, 0.07 and 0.02.
    assert up >= 0.85
    assert (errors < 0.15).all(), errors
    idle = replace(last.policy, parameters=np.zeros_like(last.policy.parameters))
    assert judged(task, idle)[0] == 0.0
