# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The pictures of an experiment: Figure 1 of the paper, profiles, a recording and tables."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from vgps_ros.experiments.cell_table import Columns, by_panel, read_table
from vgps_ros.experiments.cells import Cell, Panel
from vgps_ros.experiments.command_line import refuse_existing
from vgps_ros.experiments.comparison_tables import (
    Results,
    improvement,
    last_costs,
    print_rows,
    summary,
)
from vgps_ros.experiments.seed_statistics import iqm, multiples, profile
from vgps_ros.search.settings import METHOD
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.views.comparison import (
    CEILING,
    Band,
    ComparisonPanel,
    Curve,
    comparison,
    profiles,
)
from vgps_ros.views.comparison_recording import record_comparison
from vgps_ros.views.plots import save
from vgps_ros.views.run_record import RunRecord, read_results

FILES = (
    *("figure1.png", "figure1.svg", "figure1.rrd", "profiles.png", "profiles.svg"),
    *("summary.csv", "improvement.csv"),
)


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
    ends = {
        kind: last_costs(results, column)
        for kind, column in (
            ("deterministic", "deterministic_cost"),
            ("stochastic", f"stochastic_cost_{average}"),
        )
    }
    levels = np.geomspace(0.9, CEILING, 201)[:-1]  # from there on all would seem to end alike
    shares = {
        kind: {method: profile(list(own.values()), levels) for method, own in methods.items()}
        for kind, methods in ends.items()
    }
    for name, drawn in (
        ("figure1", comparison(panels, runs, average)),
        ("profiles", profiles(levels, shares)),
    ):
        for ending in ("png", "svg"):
            save(drawn, output / f"{name}.{ending}")
    record_comparison(panels, runs, output / "figure1.rrd")
    for name, title, rows in (
        ("summary", "last iteration; costs ÷ initial DDP's", summary(results, average)),
        ("improvement", "probability that ours ends lower", improvement(ends)),
    ):
        if rows:
            pa.csv.write_csv(pa.Table.from_pylist(rows), output / f"{name}.csv")
            print_rows(title, rows)
    written = [path.name for path in paths if path.exists()]
    print(f"Wrote {', '.join(written)} to {output}.")


def _panel(panel: Panel, methods: Mapping[str, Columns], average: str) -> ComparisonPanel:
    def band(columns: Columns, name: str) -> Band:
        return iqm(multiples(columns[name], columns["initial_ddp_cost"]))

    return ComparisonPanel(
        title=f"{panel.task}, {panel.hidden_units} hidden units",
        curves={
            method: Curve(band(own, f"stochastic_cost_{average}"), band(own, "deterministic_cost"))
            for method, own in methods.items()
        },
    )


def _robots(root: Path, results: Results) -> list[RunRecord]:
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
