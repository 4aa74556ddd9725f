"""A whole training in this process, and the folder that it leaves."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.core.ddp import Iteration
from vgps_ros.search.checkpoints import Checkpoints
from vgps_ros.search.iteration import SearchIteration
from vgps_ros.search.methods import search
from vgps_ros.search.result_file import iteration_entry, result_content
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.trajectory_optimization import (
    OptimizationRequest,
    OptimizationResult,
    optimize,
)
from vgps_ros.storage.distribution_file import DISTRIBUTION, save_distributions
from vgps_ros.storage.files import write_json
from vgps_ros.storage.policy_file import save_policy
from vgps_ros.tasks import Task
from vgps_ros.views.run_record import RunRecord


def train(
    method: str,
    task: Task,
    settings: SearchSettings,
    seed: int,
    output: Path,
    *,
    on_iteration: Callable[[SearchIteration], None] = lambda _: None,
    on_initial_ddp: Callable[[Iteration], None] = lambda _: None,
    checkpoints: Checkpoints | None = None,
) -> dict[str, Any]:
    """Trains a policy; writes result.json and policy.json after each iteration.

    At the end trajectories.npz and distribution.npz are written too.

    Args:
        method: name of the policy search.
        task: the control problem.
        settings: of the search.
        seed: of all random draws.
        output: folder for the files; made if it is missing.
        on_iteration: called at the end of each iteration.
        on_initial_ddp: called at the end of each iteration of the initial solve.
        checkpoints: what a training that was stopped goes on from, with the same numbers.

    Returns:
        The content of result.json.

    Raises:
        VgpsError: a setting is out of range, the first rollout diverges, or the checkpoints are
            those of another training.
    """
    output.mkdir(parents=True, exist_ok=True)

    def optimize_all(requests: Sequence[OptimizationRequest]) -> list[OptimizationResult]:
        reports = [on_initial_ddp if r.iteration == 0 else lambda _: None for r in requests]
        return [optimize(task, r, report) for r, report in zip(requests, reports, strict=True)]

    for iteration in search(method, task, settings, seed, optimize_all, checkpoints):
        content = result_content(
            task=task.name,
            method=method,
            seed=seed,
            hidden_units=settings.hidden_units,
            num_parameters=iteration.policy.architecture.num_parameters,
            initial_ddp_cost=iteration.initial_ddp_cost,
            iterations=[iteration_entry(figures) for figures in iteration.history],
        )
        write_json(output / "result.json", content)
        save_policy(iteration.policy, task.name, output / "policy.json")
        on_iteration(iteration)
    _save_motions(task, iteration, content, output)
    return content


def _save_motions(
    task: Task, iteration: SearchIteration, content: dict[str, Any], output: Path
) -> None:
    """Writes trajectories.npz, of the first initial state, and distribution.npz, of all."""
    policy = iteration.policy
    initial, last = (
        solutions[0].distribution.first(task.horizon)
        for solutions in (iteration.initial_solutions, iteration.solutions)
    )
    executed = task.dynamics.rollout(
        initial.mean.states[0], lambda t, x: policy.mean(x), task.horizon
    )
    RunRecord(
        task.model_path.read_text(),
        task.dynamics.time_step,
        content,
        initial.mean.states,
        last.mean.states,
        last.state_covariances,
        executed.states[np.isfinite(executed.states).all(axis=1)],  # until it diverged
    ).save_trajectories(output)
    scored = [solution.distribution.first(task.horizon) for solution in iteration.solutions]
    save_distributions(scored, task.name, output / DISTRIBUTION)
