# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmarks of policy search: where its time goes, and how it grows."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial, wraps
from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.problems import SEED
from benchmarks.timing import Comparison
from vgps_ros.core.policy_cost import PolicyCost
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.tasks import Task, make_task

# What takes the time of a search: where each part is called from.
PARTS = {
    "derivatives": (Dynamics, "linearize"),
    "backward passes": ("vgps_ros.core.ddp.forward_pass", "backward_pass"),
    "forward passes": ("vgps_ros.core.ddp.solve", "forward_pass"),
    "expansion of the policy's cost": (PolicyCost, "expand"),
    "marginals": ("vgps_ros.search.trajectory_optimization", "state_covariances"),
    "M-step": ("vgps_ros.search.workspace", "fit_policy"),
    "evaluation": ("vgps_ros.search.methods", "evaluate"),
}
SEARCHES = {"swimmer": 5, "walker": 10}  # task: hidden units
HORIZONS = (100, 200, 500, 1000, 2000, 4000)
HIDDEN_UNITS = (5, 10, 50, 100, 500)
INITIAL_STATES = (1, 2, 4, 8, 16)
EXPONENT_LIMIT = 1.15  # of a growth that is called linear
_ITERATIONS = 4  # of each search; the first is not counted


def shares() -> Iterator[Comparison]:
    """Where the time of a search goes: 50 iterations on swimmer and walker."""
    for name, hidden_units in SEARCHES.items():
        task = make_task(name)
        settings = replace(search_settings(task), hidden_units=(hidden_units,))
        with ExitStack() as stack:
            spent = {part: stack.enter_context(_timed(*place)) for part, place in PARTS.items()}
            began = time.perf_counter()
            for _ in search("vgps", task, settings, SEED, partial(optimize_all, task)):
                pass
            total = time.perf_counter() - began
        for part, seconds in spent.items():
            yield Comparison(
                f"{name}, {hidden_units} units, {settings.iterations} iterations: {part} / all",
                1e3 * sum(seconds),
                1e3 * total,
                None,
            )


@contextmanager
def _timed(owner: Any, name: str) -> Iterator[list[float]]:
    """Gives the duration of each call of a function while the context lasts [s]."""
    if isinstance(owner, str):
        owner = import_module(owner)
    function = getattr(owner, name)
    durations: list[float] = []

    @wraps(function)
    def timed(*arguments: Any, **named: Any) -> Any:
        began = time.perf_counter()
        try:
            return function(*arguments, **named)
        finally:
            durations.append(time.perf_counter() - began)

    setattr(owner, name, timed)
    try:
        yield durations
    finally:
        setattr(owner, name, function)


def growth() -> Iterator[Comparison]:
    """Time of an iteration against horizon, hidden units and initial states; exponents."""
    swimmer = make_task("swimmer")
    quick = {"initial_ddp_iterations": 2, "evaluation_rollouts": 1}
    cases: dict[str, tuple[Sequence[int], Callable[[int], float]]] = {
        "horizon": (HORIZONS, lambda n: _iteration_seconds(replace(swimmer, horizon=n), **quick)),
        "initial states": (
            INITIAL_STATES,
            lambda n: _iteration_seconds(swimmer, situations=n, **quick),
        ),
        "hidden units": (
            HIDDEN_UNITS,
            lambda n: _iteration_seconds(swimmer, hidden_units=(n,), **quick),
        ),
    }
    for name, (sizes, measure) in cases.items():
        times = [measure(n) for n in sizes]
        exponent = float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
        yield Comparison(
            f"swimmer: exponent of an iteration's time over {name} / linear",
            exponent,
            1.0,
            EXPONENT_LIMIT,
            unit="",
            curve=tuple(zip(sizes, times, strict=True)),
        )


def _iteration_seconds(task: Task, **settings: Any) -> float:
    """Returns the median time of an iteration after the first [s]."""
    chosen = replace(search_settings(task), iterations=_ITERATIONS, **settings)
    run = search("vgps", task, chosen, SEED, partial(optimize_all, task))
    ends = [time.perf_counter() for _ in run]
    return float(np.median(np.diff(ends)))
