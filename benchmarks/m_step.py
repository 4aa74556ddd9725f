# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Gauss-Newton steps beside L-BFGS: from the same start to the same likelihood."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import repeat

from benchmarks.problems import SEED
from benchmarks.timing import Comparison
from vgps_ros.core.fit_loss import minimize_gauss_newton
from vgps_ros.core.policy_fit import draw_targets, fit_loss
from vgps_ros.core.policy_network import minimize_lbfgs
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import OptimizationResult, optimize_all
from vgps_ros.search.workspace import Workspace
from vgps_ros.tasks import make_task

HIDDEN_UNITS = ((5,), (10,), (64,), (64, 64))
LBFGS_ITERATIONS = 200
_LIMIT = 0.5


def m_step() -> Iterator[Comparison]:
    """The first fit to the walker's initial solution, from a random network."""
    task = make_task("walker")
    solutions: tuple[OptimizationResult, ...] = ()
    for hidden_units in HIDDEN_UNITS:
        settings = replace(search_settings(task), hidden_units=hidden_units)
        work = Workspace(task, settings, SEED, partial(optimize_all, task), solutions)
        solutions = work.initial_solutions
        q, scaling = work.scored(work.initial_solutions), work.standardization()
        rng = generator(SEED, Stream.POLICY_FIT, 1)
        samples = settings.fit.samples_per_step
        targets = draw_targets(q, task.observation, settings.fit.form, samples, rng)
        loss = fit_loss(scaling, targets)
        start = scaling.to_standard(work.random_policies(1)[0].parameters)
        theirs, theirs_ms = _timed(
            partial(minimize_lbfgs, start, loss.value_and_gradient, LBFGS_ITERATIONS)
        )
        for steps in range(1, LBFGS_ITERATIONS):
            ours, ours_ms = _timed(partial(minimize_gauss_newton, start, repeat(loss), steps, 0.0))
            if loss.value(ours) <= loss.value(theirs):
                break
        yield Comparison(
            f"walker, {' and '.join(map(str, hidden_units))} units: {steps} Gauss-Newton steps / "
            f"{LBFGS_ITERATIONS} of L-BFGS, of no better likelihood",
            ours_ms,
            theirs_ms,
            _LIMIT,
        )


def _timed(fit: Callable[[], Array]) -> tuple[Array, float]:
    """Returns a fit's result and its time [ms]."""
    began = time.perf_counter()
    found = fit()
    return found, 1e3 * (time.perf_counter() - began)
