# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmarks of policy search: where its time goes, and how it grows."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial, wraps
from importlib import import_module
from itertools import repeat
from typing import Any

import numpy as np
from scipy.stats import linregress
from scipy.stats import t as student_t

from benchmarks.problems import SEED, chain
from benchmarks.timing import Comparison, compare
from vgps_ros.core.fit_loss import minimize_gauss_newton
from vgps_ros.core.policy_cost import PolicyCost
from vgps_ros.core.policy_fit import draw_targets, fit_loss
from vgps_ros.core.policy_network import minimize_lbfgs
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.methods import search
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.settings import search_settings
from vgps_ros.search.solver_processes import SolverProcesses
from vgps_ros.search.trajectory_optimization import OptimizationResult, Outcome, optimize_all
from vgps_ros.search.workspace import Workspace
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
HIDDEN_UNITS = (5, 16, 64, 128, 256)
SITUATIONS = (1, 4, 16, 32, 64)
LINKS = (2, 5, 10, 20, 35)  # of a chain, which has twice as many states
LINEAR, CUBIC = 1.0, 3.0
_TOLERANCE = 0.15  # of an exponent
_ITERATIONS = 4  # of each search; the first is not counted
NETWORKS = ((5,), (10,), (64,), (64, 64))
LBFGS_ITERATIONS = 200
_M_STEP_LIMIT = 0.5


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


def workers() -> Iterator[Comparison]:
    """The solves of an iteration of the quadruped's 24 situations: two processes against one."""
    task, asked = make_task("quadruped"), list[Sequence[OptimizationRequest]]()
    make = partial(make_task, task.name)
    with SolverProcesses(make, 1) as one, SolverProcesses(make, 2) as two:

        def solve(requests: Sequence[OptimizationRequest]) -> list[Outcome]:
            asked.append(requests)
            return two.optimize_all(requests)

        for _ in search("vgps", task, replace(search_settings(task), iterations=1), SEED, solve):
            pass
        yield compare(
            f"quadruped: solves of {len(asked[-1])} situations, two processes / one",
            partial(two.optimize_all, asked[-1]),
            partial(one.optimize_all, asked[-1]),
            0.55,
            repetitions=5,
        )


def growth() -> Iterator[Comparison]:
    """Time of an iteration against horizon, situations, hidden units and states; exponents."""
    swimmer = make_task("swimmer")

    def seconds(task: Task = swimmer, **settings: Any) -> float:
        settings = {"initial_ddp_iterations": 2, "evaluation_rollouts": 1, **settings}
        return _iteration_seconds(task, **settings)

    cases: dict[str, tuple[Sequence[int], float, Callable[[int], float]]] = {
        "swimmer: horizon": (HORIZONS, LINEAR, lambda n: seconds(replace(swimmer, horizon=n))),
        "swimmer: situations": (SITUATIONS, LINEAR, lambda n: seconds(situations=n)),
        "swimmer: hidden units": (HIDDEN_UNITS, LINEAR, lambda n: seconds(hidden_units=(n,))),
        "chain: states": ([2 * n for n in LINKS], CUBIC, lambda n: seconds(chain(n // 2))),
    }
    for name, (sizes, expected, measure) in cases.items():
        times = [measure(n) for n in sizes]
        found = linregress(np.log(sizes), np.log(times))
        half = student_t.ppf(0.975, len(sizes) - 2) * found.stderr
        yield Comparison(
            f"{name}: exponent of an iteration's time / {expected:g}",
            float(found.slope),
            expected,
            1.0 + _TOLERANCE / expected,
            unit="",
            remark=f"exponent {found.slope:.2f} ± {half:.2f} (95 %), {sizes[0]} to {sizes[-1]}",
            curve=tuple(zip(sizes, times, strict=True)),
        )


def _iteration_seconds(task: Task, **settings: Any) -> float:
    """Returns the median time of an iteration after the first [s]."""
    chosen = replace(search_settings(task), iterations=_ITERATIONS, **settings)
    run = search("vgps", task, chosen, SEED, partial(optimize_all, task))
    ends = [time.perf_counter() for _ in run]
    return float(np.median(np.diff(ends)))


def m_step() -> Iterator[Comparison]:
    """Gauss-Newton steps beside L-BFGS, in the first fit to the walker's initial solution."""
    task = make_task("walker")
    solutions: tuple[OptimizationResult, ...] = ()
    for hidden_units in NETWORKS:
        settings = replace(search_settings(task), hidden_units=hidden_units)
        work = Workspace(task, settings, SEED, partial(optimize_all, task), solutions)
        solutions = work.initial_solutions
        q, scaling = work.scored(work.initial_solutions), work.standardization()
        rng = generator(SEED, Stream.POLICY_FIT, 1)
        samples = settings.fit.samples_per_step
        targets = draw_targets(q, task.observation, samples, rng)
        loss = fit_loss(scaling, targets)
        start = scaling.to_standard(work.first_policy().parameters)
        theirs, theirs_ms = _done(
            partial(minimize_lbfgs, start, loss.value_and_gradient, LBFGS_ITERATIONS)
        )
        for steps in range(1, LBFGS_ITERATIONS):
            ours, ours_ms = _done(partial(minimize_gauss_newton, start, repeat(loss), steps, 0.0))
            if loss.value(ours) <= loss.value(theirs):
                break
        yield Comparison(
            f"walker, {' and '.join(map(str, hidden_units))} units: {steps} Gauss-Newton steps / "
            f"{LBFGS_ITERATIONS} of L-BFGS, of no better likelihood",
            ours_ms,
            theirs_ms,
            _M_STEP_LIMIT,
        )


def _done(fit: Callable[[], Array]) -> tuple[Array, float]:
    """Returns a fit's result and its time [ms]."""
    began = time.perf_counter()
    found = fit()
    return found, 1e3 * (time.perf_counter() - began)
