# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The curves of the paper's comparison (section 6), which Figure 1 draws, and their settings.

Each curve is a method. All of them have the paper's schedule, in which α falls, and what the
paper's methods share. Beyond that each has its own settings on each task (tuned.yaml), which
`tune.py` has chosen with the same number of trials for each. One curve
more, `vgps_rising`, is vgps with the tasks' own settings, in which α rises.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vgps_ros.core.settings import settings_of, with_values
from vgps_ros.search.settings import OF_PAPER, SearchSettings, search_settings
from vgps_ros.storage.files import read_yaml

if TYPE_CHECKING:  # it imports the simulator, which the names of the curves do without
    from vgps_ros.tasks import Task

RISING = "vgps_rising"
MOST_JOBS = 1024  # cells that are trained at once
CURVES = (*OF_PAPER, RISING)
TUNED = Path(__file__).with_name("tuned.yaml")

# Of every task: fits and q-steps do not end as they converge, the region of the fit shrinks with α,
# and vgps never rolls its policy out.
_SHARED = {
    "alphas": (1.0, 0.1),
    "alpha_iterations": (0, 50),
    "visited_limit": 0.0,
    "fit.optimizer": "lbfgs",
    "fit.samples_per_step": 10,
    "fit.iterations": 100,
    "bound_tolerance": 0.0,
    "marginals.std_limit_annealing": 0.5,
}
# The walker's marginals are no wider than the noise makes them.
_OF_TASK: Mapping[str, Mapping[str, Any]] = {
    "swimmer": {"ddp_iterations": 3},
    "walker": {
        "ddp.distribution_regularization": 0.1,
        "marginals.initial_std_factor": 1.0,
        "marginals.velocity_noise": 0.0,
    },
}


def method_of(curve: str) -> str:
    """Returns the name of a curve's method."""
    return "vgps" if curve == RISING else curve


def tuned() -> dict[str, dict[str, dict[str, Any]]]:
    """Returns the settings that tuning has chosen: by task, by curve, by dotted name."""
    return read_yaml(TUNED.read_bytes(), f"'{TUNED}'") or {}


def configured(
    task: "Task", curve: str, own: Mapping[str, Any] | None = None
) -> tuple["Task", SearchSettings]:
    """Returns a task with a curve's settings of its optimizer, and the settings of the search.

    Args:
        task: a built-in task with its own settings.
        curve: name of the curve.
        own: what the curve does not share with the others; None for what tuning has chosen.

    Raises:
        InvalidInputError: a setting is unknown or out of range.
    """
    settings = search_settings(task)
    if curve == RISING:
        return task, settings
    if own is None:
        own = tuned().get(task.name, {}).get(curve, {})
    values = {**_SHARED, **_OF_TASK.get(task.name, {}), **own}
    known = {s.name for s in settings_of(task.optimizer)}
    of_optimizer = {name: value for name, value in values.items() if name in known}
    of_search = {name: value for name, value in values.items() if name not in known}
    optimizer = with_values(task.optimizer, of_optimizer)
    return replace(task, optimizer=optimizer), with_values(settings, of_search)
