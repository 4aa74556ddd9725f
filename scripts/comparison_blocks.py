# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Sums up the rows of the comparison, docs/figure1.csv, as the tables of its page."""

import sys
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # where `benchmarks` is

from benchmarks.figure1.statistics import CEILING, improvement, last_costs, summary
from benchmarks.figure1.table import by_panel

Figures = dict[str, Any]


def summed_up(path: Path) -> Figures:
    """Returns the rows of the tables, from a table of `python -m benchmarks.figure1 run`."""
    results = by_panel(pa.csv.read_csv(path))
    ends = {
        "deterministic": last_costs(results, "deterministic_cost"),
        "stochastic": last_costs(results, "stochastic_cost_median"),
    }
    rows = summary(results, "median")
    for row in rows:  # JSON has no infinity
        row["success_at"] = row["success_at"] if np.isfinite(row["success_at"]) else None
    return {"summary": rows, "improvement": improvement(ends)}


def comparison_block(figures: Figures) -> str:
    """Makes a table of each panel of the comparison, a row a method."""
    lines = []
    for panel, rows in groupby(figures["comparison"]["summary"], itemgetter("panel")):
        task, units = panel.split("-")
        lines += [
            f"{task}, {units} units:",
            "",
            "| method | without noise | with noise | succeed | first at k | stay up with noise | "
            "million steps | seconds |",
            "| --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        lines += [
            f"| {row['method']} | {_interval(row, 'deterministic')} | "
            f"{_interval(row, 'stochastic')} | {row['succeed']} of {row['seeds']} | "
            f"{_iteration(row)} | {100 * row['survival']:.0f} % | {row['million_steps']:.1f} | "
            f"{row['seconds']:.0f} |"
            for row in rows
        ]
        lines.append("")
    return "\n".join(lines[:-1])


def improvement_block(figures: Figures) -> str:
    """Makes the table of how probable it is that a seed of ours ends lower."""
    table = ["| ours | against | without noise | with noise |", "| --- | --- | --- | --- |"]
    table += [
        f"| {row['ours']} | {row['against']} | {_interval(row, 'deterministic')} | "
        f"{_interval(row, 'stochastic')} |"
        for row in figures["comparison"]["improvement"]
    ]
    return "\n".join(table)


def _interval(row: Figures, key: str) -> str:
    low, middle, high = (row[key + ending] for ending in ("_low", "", "_high"))
    # Where a policy falls, its costs say no more than that.
    return "falls" if low > 0.999 * CEILING else f"{middle:.2f} ({low:.2f} to {high:.2f})"


def _iteration(row: Figures) -> str:
    at = row["success_at"]
    return "–" if at is None else f"{at:.0f}"
