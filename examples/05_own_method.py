# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy search of one's own: evolution strategies beside the eight methods of the package.

A method is a function that does iteration k; all else is shared: `python examples/05_own_method.py`
"""

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.methods import METHODS, Method
from vgps_ros.search.settings import search_settings
from vgps_ros.search.training import train
from vgps_ros.search.workspace import Update, Workspace
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.tasks import make_task

PAIRS, WIDTH, RATE = 16, 0.05, 0.02


def evolution_strategies(work: Workspace, last: Update | None, k: int) -> Update:
    """Moves the parameters away from costly perturbations, in pairs (Salimans et al., 2017)."""
    if last is None:  # begin as a copy of the DDP solution, as all methods do
        return Update(work.supervised_policy(), work.initial_solutions)
    policy, rng = last.policy, generator(work.seed, Stream.POLICY_PARAMETERS, k)
    directions = rng.standard_normal((PAIRS, len(policy.parameters)))
    tried = [[moved(policy, sign * WIDTH * d) for sign in (1, -1)] for d in directions]
    costs = np.array([[cost_of(work, each) for each in pair] for pair in tried])
    ranks = costs.ravel().argsort().argsort().reshape(costs.shape) / costs.size
    gradient = (ranks[:, 0] - ranks[:, 1]) @ directions / PAIRS
    return Update(moved(policy, -RATE * gradient), work.initial_solutions)


def moved(policy: GaussianPolicy, step: np.ndarray) -> GaussianPolicy:
    """Returns the policy with changed parameters."""
    return replace(policy, parameters=policy.parameters + step)


def cost_of(work: Workspace, policy: GaussianPolicy) -> float:
    """Returns the mean cost without noise in all situations; a rollout that diverged costs 1e9."""
    law = lambda t, x: policy.mean(work.task.observation(x))  # noqa: E731
    motions = ((t, t.dynamics.rollout(t.initial_state, law, t.horizon)) for t in work.tasks)
    return float(np.nan_to_num([t.trajectory_cost(m) for t, m in motions], nan=1e9).mean())


METHODS["evolution_strategies"] = Method(evolution_strategies, Update)
task = make_task("rotor")
settings = replace(search_settings(task), supervised_iterations=1,
                   iterations=int(os.environ.get("ITERATIONS", "20")))  # fmt: skip
report = lambda done: print(f"{done.k}: {done.deterministic_cost:.4f}", flush=True)  # noqa: E731
with tempfile.TemporaryDirectory() as path:
    output = RunFolder(Path(path))
    result = train("evolution_strategies", task, settings, 0, output, on_iteration=report)
print(f"DDP: {result['initial_ddp_cost']:.4f}")
