# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs a whole training in this process and writes the folder of its results."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import yaml

from vgps_ros.core.ddp.solve import Iteration
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.settings import values_of
from vgps_ros.search.checkpoints import Checkpoints
from vgps_ros.search.iteration import SearchIteration
from vgps_ros.search.methods import search
from vgps_ros.search.metrics import result_content
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.solver_processes import SolverProcesses
from vgps_ros.search.trajectory_optimization import Outcome, attempt
from vgps_ros.storage.files import replacing, write_archive
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
    on_initial_progress: Callable[[float], None] = lambda _: None,
    checkpoints: Checkpoints | None = None,
    solvers: SolverProcesses | None = None,
    command: str = "",
    first_policy: GaussianPolicy | None = None,
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
        on_initial_progress: called during the initial solves, with the share that is done.
        checkpoints: checkpoints from which a training that was stopped goes on, if given.
        solvers: processes that solve several requests at once; None: this one solves them in turn.
        command: the command of the training, for its record.
        first_policy: the policy that the first fit begins with; None: it is drawn at random.

    Returns:
        The content of result.json.

    Raises:
        VgpsError: a setting is out of range, the first rollout diverges, or the checkpoints belong
            to another training.
    """
    output.path.mkdir(parents=True, exist_ok=True)  # before hours of learning, if it cannot be made
    with replacing(output.environment) as file:
        file.write((environment() + _record(method, task, settings, seed, command)).encode())

    def optimize_all(requests: Sequence[OptimizationRequest]) -> Sequence[Outcome]:
        report = on_initial_progress if requests[0].iteration == 0 else lambda _: None
        if solvers and len(requests) > 1:
            return solvers.optimize_all(requests, report)
        outcomes = list[Outcome]()

        def show(iteration: Iteration) -> None:
            done = len(outcomes) + iteration.index / requests[0].max_iterations
            report(done / len(requests))

        for request in requests:
            outcomes.append(attempt(task, request, show))
        return outcomes

    found = search(method, task, settings, seed, optimize_all, checkpoints, first_policy)
    for iteration in found:
        policy, history = iteration.policy, iteration.history
        content = result_content(task.name, method, seed, policy, history)
        output.save(content, policy)
        on_iteration(iteration)
    _save_motions(task, iteration, output)
    return content


def _record(method: str, task: Task, settings: SearchSettings, seed: int, command: str) -> str:
    """Returns what was trained as YAML, with the settings that differ from their defaults."""
    usual = values_of(SearchSettings(), OptimizerSettings())
    values = values_of(settings, task.optimizer).items()
    record = {
        "command": command,
        "method": method,
        "seed": seed,
        "settings": {name: value for name, value in values if value != usual[name]},
    }
    return str(yaml.safe_dump({"training": record}, sort_keys=False))


def _save_motions(task: Task, iteration: SearchIteration, output: RunFolder) -> None:
    """Writes trajectories.npz for the first initial state, distribution.npz for all of them."""
    policy = iteration.policy
    initial, last = (
        solutions[0].distribution.first(task.horizon)
        for solutions in (iteration.initial_solutions, iteration.solutions)
    )
    here, n_u = iteration.initial_solutions[0].situation.of(task), task.dynamics.control_dim
    states, _ = task.dynamics.execute(
        policy, here.observation, initial.mean.states[:1], np.zeros((1, task.horizon, n_u))
    )
    motions = {
        "initial_states": initial.mean.states,
        "mean_states": last.mean.states,
        "state_covariances": last.state_covariances,
        "executed_states": states[0][np.isfinite(states[0]).all(axis=1)],  # until it diverges
    }
    write_archive(output.trajectories, motions)
    scored = [solution.distribution.first(task.horizon) for solution in iteration.solutions]
    save_distributions(scored, task.name, output.distribution)
