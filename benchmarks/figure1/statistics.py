# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Statistics over the seeds of an experiment, after Agarwal et al. (NeurIPS 2021).

All are of costs as multiples of the initial DDP solution's of the same seed. A policy that fell or
diverged counts as CEILING, however its robot thrashed: it is never left out, and never outweighs
all others.

The interquartile mean (IQM) leaves out the best and the worst quarter of the seeds, so a seed in
five that falls does not show in it. It shows in the profiles, and in the probabilities.

Intervals are those of a stratified bootstrap: the seeds of each panel are drawn anew by themselves.
The library rliable computes the same where all panels have as many seeds, which they need not here.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from rich.box import SIMPLE
from rich.table import Table
from scipy.stats import bootstrap, trim_mean

from benchmarks.figure1.cells import Panel
from benchmarks.figure1.curves import RISING
from benchmarks.figure1.table import Columns
from vgps_ros.core.records import Array
from vgps_ros.search.settings import METHOD
from vgps_ros.views.console import table_console

CEILING = 20.0  # costs are counted and drawn up to this multiple of the initial DDP solution's
CONFIDENCE, RESAMPLES, LAST = 0.95, 2000, 5


@dataclass(frozen=True)
class Band:
    """A statistic over the seeds with its interval, each of the same shape."""

    middle: Array
    low: Array
    high: Array


def multiples(costs: Array, ddp_costs: Array) -> Array:
    """Returns costs as multiples of the initial DDP solutions', at most CEILING, as inf and NaN."""
    return np.fmin(costs / ddp_costs, CEILING)


def iqm(found: Array) -> Band:
    """Returns the IQM over the seeds of multiples (S, K), in their logarithms, and its interval."""
    logs = np.log(found)
    bounds = _interval([logs], _trimmed)
    return Band(*(np.exp(each) for each in (_trimmed(logs, axis=0), *bounds)))


def last_multiples(found: Array) -> Array:
    """Returns the geometric mean of each seed's last five multiples, (S,), of (S, K)."""
    return np.exp(np.log(found[:, -LAST:]).mean(axis=1))


def profile(panels: Sequence[Array], levels: Array) -> Band:
    """Returns which share of the seeds ends at each level (L,) or below, the mean over panels.

    Args:
        panels: the multiples that the seeds of each panel end at, each of shape (S,).
        levels: multiples, shape (L,).
    """
    below = [(found[:, None] <= levels).astype(float) for found in panels]
    return Band(_mean_of_means(*below, axis=0), *_interval(below, _mean_of_means))


def probability_of_improvement(ours: Sequence[Array], theirs: Sequence[Array]) -> Band:
    """Returns how probable it is that a seed of ours ends lower than one of theirs.

    It is the mean over the panels; where both end at the same multiple, as two that fall do, it is
    one half.

    Args:
        ours: the multiples that our seeds of each panel end at, each of shape (S,).
        theirs: the same of another method.
    """

    def statistic(*samples: Array, axis: int) -> Array:
        moved = [np.moveaxis(sample, axis, -1) for sample in samples]
        pairs = zip(moved[: len(ours)], moved[len(ours) :], strict=True)
        wins = [np.sign(y[..., None, :] - x[..., :, None]) for x, y in pairs]
        return np.mean([0.5 + 0.5 * each.mean(axis=(-2, -1)) for each in wins], axis=0)

    samples = [*ours, *theirs]
    return Band(statistic(*samples, axis=0), *_interval(samples, statistic))


def _trimmed(sample: Array, axis: int) -> Array:
    return np.asarray(trim_mean(sample, 0.25, axis=axis))


def _mean_of_means(*samples: Array, axis: int) -> Array:
    return np.mean([sample.mean(axis=axis) for sample in samples], axis=0)


def _interval(samples: Sequence[Array], statistic: Callable[..., Array]) -> tuple[Array, Array]:
    """Returns the bounds of a statistic over the first axis; one seed alone is drawn twice."""
    several = [np.repeat(each, 2, axis=0) if len(each) == 1 else each for each in samples]
    found = bootstrap(
        several, statistic, axis=0, vectorized=True, method="percentile", rng=0,
        n_resamples=RESAMPLES, confidence_level=CONFIDENCE,
    ).confidence_interval  # fmt: skip
    return np.asarray(found.low), np.asarray(found.high)


OURS = (METHOD.default, RISING)
SUCCESS = 1.5  # a policy succeeds if it survives at this multiple of the DDP's cost or less

Results: TypeAlias = Mapping[Panel, Mapping[str, Columns]]


def summary(results: Results, average: str) -> list[dict[str, Any]]:
    """Returns the rows of the summary.

    Costs are interquartile means over the seeds, as multiples of the initial DDP solution's cost,
    with the bounds of their 95 % intervals; all other figures are medians. `succeed` is the
    number of seeds whose last deterministic policy succeeds. `success_at` is the first iteration
    with such a policy, which is infinite for seeds without one. `survival` is the share of
    stochastic rollouts that survive.
    """
    return [
        {"panel": str(panel), "method": method, **_figures(result, average)}
        for panel, methods in results.items()
        for method, result in methods.items()
    ]


def _figures(columns: Columns, average: str) -> dict[str, float]:
    ddp = columns["initial_ddp_cost"]
    bounded = columns["deterministic_cost"] <= SUCCESS * ddp
    success = bounded & (columns["deterministic_survival"] == 1.0)
    first = np.where(success.any(axis=1), success.argmax(axis=1) + 1.0, np.inf)

    def last(values: Array) -> float:
        return float(np.median(values[:, -1]))

    costs = {}
    for kind, name in (
        ("deterministic", "deterministic_cost"), ("stochastic", f"stochastic_cost_{average}"),
    ):  # fmt: skip
        band = iqm(multiples(columns[name], ddp)[:, -1:])
        for ending, part in (("", band.middle), ("_low", band.low), ("_high", band.high)):
            costs[kind + ending] = float(part[0])
    return {
        "seeds": len(ddp),
        **costs,
        "succeed": int(success[:, -1].sum()),
        "success_at": float(np.median(first)),
        "survival": last(columns["stochastic_survival"]),
        "million_steps": last(columns["simulator_steps"]) / 1e6,
        "seconds": last(columns["seconds"]),
    }


def last_costs(results: Results, column: str) -> dict[str, dict[Panel, Array]]:
    """Returns the multiple that each seed of each method ends at, in each panel."""
    found: dict[str, dict[Panel, Array]] = {}
    for panel, methods in results.items():
        for method, own in methods.items():
            ends = last_multiples(multiples(own[column], own["initial_ddp_cost"]))
            found.setdefault(method, {})[panel] = ends
    return found


def improvement(ends: Mapping[str, Mapping[str, Mapping[Panel, Array]]]) -> list[dict[str, Any]]:
    """Returns, for ours and each other method, how probable it is that a seed of ours ends lower.

    It is the mean over the panels that both have; one half where both fall. `low` and `high` are
    the bounds of its 95 % interval.
    """
    rows = []
    (methods, *_) = ends.values()
    for ours, theirs in itertools.product([name for name in OURS if name in methods], methods):
        row: dict[str, Any] = {"ours": ours, "against": theirs}
        for kind, found in ends.items():
            shared = [panel for panel in found[ours] if panel in found[theirs]]
            if ours != theirs and shared:
                own, other = ([found[name][panel] for panel in shared] for name in (ours, theirs))
                band = probability_of_improvement(own, other)
                figures = (float(part) for part in (band.middle, band.low, band.high))
                row |= dict(zip((kind, f"{kind}_low", f"{kind}_high"), figures, strict=True))
        if len(row) > 2:
            rows.append(row)
    return rows


def print_rows(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Prints rows as a table, each value with its interval if it has one."""
    table = Table(title=title, box=SIMPLE)
    columns = [name for name in rows[0] if not name.endswith(("_low", "_high"))]
    for name in columns:
        is_text = isinstance(rows[0][name], str)
        table.add_column(
            name.replace("_", " "), justify="left" if is_text else "right", no_wrap=True
        )
    for row in rows:
        table.add_row(*(_shown(row, name) for name in columns))
    table_console(wide=True).print(table)


def _shown(row: Mapping[str, Any], name: str) -> str:
    """Returns a value as text, with its interval if it has one."""
    if isinstance(row[name], str):
        return row[name]
    bounds = [row[key] for key in (f"{name}_low", f"{name}_high") if key in row]
    interval = f" ({bounds[0]:.3g}–{bounds[1]:.3g})" if bounds else ""
    return f"{row[name]:.4g}{interval}"
