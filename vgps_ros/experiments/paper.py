# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The settings of the paper's comparison (section 6), which Figure 1 was made with.

They are older than what the tasks now begin with: α falls, q-steps and fits are short, and the
walker's marginals are no wider than the noise makes them. All methods of the comparison share them.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from vgps_ros.core.settings import with_values
from vgps_ros.search.settings import SearchSettings, search_settings
from vgps_ros.tasks import Task, make_task

# Of every task: fits and q-steps that do not end as they converge.
_FIT = {"fit.optimizer": "lbfgs", "fit.samples_per_step": 10, "fit.iterations": 100}
_STEP = {"bound_tolerance": 0.0}
_SEARCH: Mapping[str, Mapping[str, Any]] = {"swimmer": {"ddp_iterations": 3}}
_OPTIMIZERS: Mapping[str, Mapping[str, Any]] = {
    "swimmer": {"marginals.std_limit_annealing": 0.5},
    "walker": {
        "ddp.distribution_regularization": 0.1,
        "marginals.initial_std_factor": 1.0,
        "marginals.velocity_noise": 0.0,
        "marginals.std_limit_annealing": 0.5,
    },
}


def paper_task(name: str) -> Task:
    """Returns a built-in task with the paper's settings of its optimizer."""
    task = make_task(name)
    values = {**_STEP, **_OPTIMIZERS.get(name, {})}
    return replace(task, optimizer=with_values(task.optimizer, values))


def paper_settings(task: Task) -> SearchSettings:
    """Returns the paper's settings of a search."""
    values = {"schedule": "paper", "visited_limit": 0.0, **_FIT, **_SEARCH.get(task.name, {})}
    return with_values(search_settings(task), values)
