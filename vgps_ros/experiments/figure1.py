# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The pictures of an experiment: Figure 1 of the paper, a recording and a summary."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
from rich.box import SIMPLE
from rich.table import Table

from vgps_ros.core.records import Array
from vgps_ros.experiments.cell_table import Columns, by_panel, read_table
from vgps_ros.experiments.cells import Cell, Panel
from vgps_ros.experiments.command_line import refuse_existing
from vgps_ros.search.settings import METHOD
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.views.comparison import ComparisonPanel, Curve, comparison
from vgps_ros.views.comparison_recording import record_comparison
from vgps_ros.views.plots import save
from vgps_ros.views.run_record import RunRecord, read_results
from vgps_ros.views.table_console import table_console

FILES = ("figure1.png", "figure1.svg", "figure1.rrd", "summary.csv")
SUCCESS = 1.5  # a policy succeeds if it survives at this multiple of the DDP's cost or less


def draw_figure(root: Path, output: Path, *, average: str, overwrite: bool) -> None:
    """Draws the finished cells of an experiment, and prints the summary.

    Args:
        root: the experiment's folder.
        output: folder for the pictures.
        average: whether a stochastic cost is the mean or the median of its rollouts.
        overwrite: whether pictures there may be replaced.

    Raises:
        InvalidInputError: there is no experiment, or a picture is there already.
    """
    results = by_panel(read_table(root))
    paths = [output / name for name in FILES]
    refuse_existing(paths, overwrite=overwrite)
    output.mkdir(parents=True, exist_ok=True)
    for path in paths:
        path.unlink(missing_ok=True)
    panels = [_panel(panel, methods, average) for panel, methods in results.items()]
    runs = _robots(root, results)
    drawn = comparison(panels, runs, average)
    for path in paths[:2]:
        save(drawn, path)
    record_comparison(panels, runs, paths[2])
    rows = summary(results)
    pa.csv.write_csv(pa.Table.from_pylist(rows), paths[3])
    title = "last iteration; costs as multiples of the initial DDP solution's"
    table = Table(title=title, box=SIMPLE)
    for name in rows[0] if rows else ():
        text = name in ("panel", "method")
        table.add_column(name.replace("_", " "), justify="left" if text else "right", no_wrap=text)
    for row in rows:
        table.add_row(*(v if isinstance(v, str) else f"{v:.4g}" for v in row.values()))
    table_console(wide=True).print(table)
    print(f"Wrote {', '.join(FILES)} to {output}.")


def _panel(panel: Panel, methods: Mapping[str, Columns], average: str) -> ComparisonPanel:
    first = next(iter(methods.values()))
    return ComparisonPanel(
        title=f"{panel.task}, {panel.hidden_units} hidden units",
        ddp_cost=float(np.median(first["initial_ddp_cost"])),
        curves={
            method: Curve(r[f"stochastic_cost_{average}"], r["deterministic_cost"])
            for method, r in methods.items()
        },
    )


def _robots(root: Path, results: Mapping[Panel, Mapping[str, Columns]]) -> list[RunRecord]:
    """The run of the lowest cost that our method has for each task, if it has one."""
    best: dict[str, tuple[float, Cell]] = {}
    for panel, methods in results.items():
        if METHOD.default in methods:
            result = methods[METHOD.default]
            for seed, costs in zip(result["seed"][:, 0], result["deterministic_cost"], strict=True):
                found = (float(costs[-1]), Cell(panel, METHOD.default, int(seed)))
                best[panel.task] = min(best.get(panel.task, found), found, key=lambda pair: pair[0])
    cells = [cell for cost, cell in best.values() if np.isfinite(cost)]
    return [read_results(RunFolder(cell.folder(root))) for cell in cells]


def summary(results: Mapping[Panel, Mapping[str, Columns]]) -> list[dict[str, Any]]:
    """Returns the rows of the summary.

    Costs are medians over the seeds, as multiples of the initial DDP solution's cost. `succeed` is
    the number of seeds whose last deterministic policy succeeds. `success_at` is the median of the
    first iteration with such a policy, which is infinite for seeds without one. `survival` is the
    share of stochastic rollouts that survive.
    """
    return [
        {"panel": str(panel), "method": method, **_figures(result)}
        for panel, methods in results.items()
        for method, result in methods.items()
    ]


def _figures(columns: Columns) -> dict[str, float]:
    ddp = columns["initial_ddp_cost"]
    bounded = columns["deterministic_cost"] <= SUCCESS * ddp
    success = bounded & (columns["deterministic_survival"] == 1.0)
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
