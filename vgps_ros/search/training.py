# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs a whole training in this process and writes the folder of its results."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from vgps_ros.core.ddp.solve import Iteration
from vgps_ros.search.checkpoints import Checkpoints
from vgps_ros.search.iteration import SearchIteration
from vgps_ros.search.methods import search
from vgps_ros.search.metrics import result_content
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.run_record import RunRecord
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.trajectory_optimization import OptimizationResult, optimize
from vgps_ros.storage.files import replacing
from vgps_ros.storage.run_folder import RunFolder, save_distributions
from vgps_ros.storage.software import environment
from vgps_ros.tasks import Task


def train(
    method: str,
    task: Task,
    settings: SearchSettings,
    seed: int,
    output: RunFolder,
    *,
    on_iteration: Callable[[SearchIteration], None] = lambda _: None,
    on_initial_ddp: Callable[[Iteration], None] = lambda _: None,
    checkpoints: Checkpoints | None = None,
) -> dict[str, Any]:
    """Trains a policy.

    It writes environment.yaml first, result.json and policy.json after each iteration, and
    trajectories.npz and distribution.npz at the end.

    Args:
        method: name of the policy search.
        task: the control problem.
        settings: settings of the search.
        seed: seed of all random draws.
        output: folder for the files, which is made if it is missing.
        on_iteration: called at the end of each iteration.
        on_initial_ddp: called at the end of each DDP iteration of the initial solve.
        checkpoints: checkpoints from which a training that was stopped goes on, if given.

    Returns:
        The content of result.json.

    Raises:
        VgpsError: a setting is out of range, the first rollout diverges, or the checkpoints belong
            to another training.
    """
    output.path.mkdir(parents=True, exist_ok=True)  # before hours of learning, if it cannot be made
    with replacing(output.environment) as file:
        file.write(environment().encode())

    def optimize_all(requests: Sequence[OptimizationRequest]) -> list[OptimizationResult]:
        reports = [on_initial_ddp if r.iteration == 0 else lambda _: None for r in requests]
        return [optimize(task, r, report) for r, report in zip(requests, reports, strict=True)]

    for iteration in search(method, task, settings, seed, optimize_all, checkpoints):
        policy, history = iteration.policy, iteration.history
        content = result_content(task.name, method, seed, policy, history)
        output.save(content, policy)
        on_iteration(iteration)
    _save_motions(task, iteration, content, output)
    return content


def _save_motions(
    task: Task, iteration: SearchIteration, content: dict[str, Any], output: RunFolder
) -> None:
    """Writes trajectories.npz for the first initial state, distribution.npz for all of them."""
    policy = iteration.policy
    initial, last = (
        solutions[0].distribution.first(task.horizon)
        for solutions in (iteration.initial_solutions, iteration.solutions)
    )
    executed = task.dynamics.rollout(
        initial.mean.states[0], lambda t, x: policy.mean(task.observation(x)), task.horizon
    )
    RunRecord(
        task.mjcf,
        task.dynamics.time_step,
        content,
        initial.mean.states,
        last.mean.states,
        last.state_covariances,
        executed.states[np.isfinite(executed.states).all(axis=1)],  # the states before it diverged
    ).save_trajectories(output)
    scored = [solution.distribution.first(task.horizon) for solution in iteration.solutions]
    save_distributions(scored, task.name, output.distribution)
