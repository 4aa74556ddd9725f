"""Summarises an experiment in one row for each panel and method."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.box import SIMPLE
from rich.table import Table

from vgps_ros.core.records import Array
from vgps_ros.experiments.cell_table import MethodResults
from vgps_ros.experiments.cells import Panel

SUCCESS = 1.5  # a policy succeeds if it survives at this multiple of the DDP's cost or less


def summary(results: Mapping[Panel, Mapping[str, MethodResults]]) -> list[dict[str, Any]]:
    """Returns the rows of the summary.

    Costs are medians over the seeds, as multiples of the initial DDP solution's cost. `succeed` is
    the number of seeds whose last deterministic policy succeeds. `success_at` is the median of the
    first iteration with such a policy, which is infinite for seeds without one. `survival` is the
    share of stochastic rollouts that survive.
    """
    return [
        {"panel": str(panel), "method": method, **_figures(result.columns)}
        for panel, methods in results.items()
        for method, result in methods.items()
    ]


def succeeds(columns: Mapping[str, Array]) -> np.ndarray:
    """Returns True for each deterministic policy that succeeds, shape (S, K)."""
    bounded = columns["deterministic_cost"] <= SUCCESS * columns["initial_ddp_cost"]
    return np.asarray(bounded & (columns["deterministic_survival"] == 1.0))


def summary_table(rows: list[dict[str, Any]]) -> Table:
    """Returns the rows as a table for the terminal."""
    title = "last iteration; costs as multiples of the initial DDP solution's"
    table = Table(title=title, box=SIMPLE)
    for name in rows[0] if rows else ():
        text = name in ("panel", "method")
        table.add_column(name.replace("_", " "), justify="left" if text else "right", no_wrap=text)
    for row in rows:
        table.add_row(*(v if isinstance(v, str) else f"{v:.4g}" for v in row.values()))
    return table


def _figures(columns: Mapping[str, Array]) -> dict[str, float]:
    ddp = columns["initial_ddp_cost"]
    success = succeeds(columns)
    first = np.where(success.any(axis=1), success.argmax(axis=1) + 1.0, np.inf)

    def last(values: Array) -> float:
        return float(np.median(values[:, -1]))

    return {
        "seeds": len(ddp),
        "deterministic": last(columns["deterministic_cost"] / ddp),
        "stochastic": last(columns["stochastic_cost_mean"] / ddp),
        "succeed": int(success[:, -1].sum()),
        "success_at": float(np.median(first)),
        "survival": last(columns["stochastic_survival"]),
        "million_steps": last(columns["simulator_steps"]) / 1e6,
        "seconds": last(columns["seconds"]),
    }
