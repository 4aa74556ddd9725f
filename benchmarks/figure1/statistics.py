# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What the rows of Figure 1 amount to, by the statistics of `vgps_ros.search.seed_statistics`.

All are of costs as multiples of the initial DDP solution's of the same seed. A policy that fell or
diverged counts as CEILING, however its robot thrashed: it is never left out, and never outweighs
all others.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from rich.box import SIMPLE
from rich.table import Table

from benchmarks.figure1.cells import Panel
from benchmarks.figure1.curves import RISING
from benchmarks.figure1.table import Columns
from vgps_ros.core.records import Array
from vgps_ros.search.seed_statistics import (
    Band,
    interquartile_mean,
    probability_of_improvement,
    with_interval,
)
from vgps_ros.search.settings import METHOD
from vgps_ros.views.console import table_console

CEILING = 20.0  # costs are counted and drawn up to this multiple of the initial DDP solution's
LAST = 5  # iterations, of which a seed's end is the mean


def multiples(costs: Array, ddp_costs: Array) -> Array:
    """Returns costs as multiples of the initial DDP solutions', at most CEILING, as inf and NaN."""
    return np.fmin(costs / ddp_costs, CEILING)


def iqm(found: Array) -> Band:
    """Returns the IQM over the seeds of multiples (S, K), in their logarithms, and its interval."""
    band = with_interval(interquartile_mean, np.log(found))
    return Band(*(np.exp(each) for each in vars(band).values()))


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
    return with_interval(_mean_of_means, *below)


def _mean_of_means(*samples: Array, axis: int) -> Array:
    return np.mean([sample.mean(axis=axis) for sample in samples], axis=0)


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
