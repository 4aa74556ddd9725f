"""The pictures of an experiment: Figure 1 of the paper, a recording and a summary."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from vgps_ros.experiments.cell_table import MethodResults, by_panel, read_table
from vgps_ros.experiments.cells import Cell, Panel
from vgps_ros.experiments.command_line import refuse_existing
from vgps_ros.experiments.summary import summary
from vgps_ros.search.settings import METHOD
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.views.comparison import ComparisonPanel, Curve, comparison
from vgps_ros.views.comparison_recording import record_comparison
from vgps_ros.views.plots import save
from vgps_ros.views.run_record import RunRecord, read_results

_PICTURES = ("figure1.png", "figure1.svg")
_RECORDING = "figure1.rrd"
_SUMMARY = "summary.csv"
FILES = (*_PICTURES, _RECORDING, _SUMMARY)


def draw_figure(root: Path, output: Path, *, average: str, overwrite: bool) -> list[dict[str, Any]]:
    """Draws the finished cells of an experiment.

    Args:
        root: the experiment's folder.
        output: folder for the pictures.
        average: whether a stochastic cost is the mean or the median of its rollouts.
        overwrite: whether pictures there may be replaced.

    Returns:
        The summary, one row for each panel and method.

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
    for name in _PICTURES:
        save(drawn, output / name)
    record_comparison(panels, runs, output / _RECORDING)
    rows = summary(results)
    pa.csv.write_csv(pa.Table.from_pylist(rows), output / _SUMMARY)
    return rows


def _panel(panel: Panel, methods: Mapping[str, MethodResults], average: str) -> ComparisonPanel:
    first = next(iter(methods.values()))
    return ComparisonPanel(
        title=f"{panel.task}, {panel.hidden_units} hidden units",
        ddp_cost=float(np.median(first.columns["initial_ddp_cost"])),
        curves={
            method: Curve(r.columns[f"stochastic_cost_{average}"], r.columns["deterministic_cost"])
            for method, r in methods.items()
        },
    )


def _robots(root: Path, results: Mapping[Panel, Mapping[str, MethodResults]]) -> list[RunRecord]:
    """The run of the lowest cost that our method has for each task, if it has one."""
    best: dict[str, tuple[float, Cell]] = {}
    for panel, methods in results.items():
        if METHOD.default in methods:
            result = methods[METHOD.default]
            for seed, costs in zip(result.seeds, result.columns["deterministic_cost"], strict=True):
                found = (float(costs[-1]), Cell(panel, METHOD.default, seed))
                best[panel.task] = min(best.get(panel.task, found), found, key=lambda pair: pair[0])
    cells = [cell for cost, cell in best.values() if np.isfinite(cost)]
    return [read_results(RunFolder(cell.folder(root))) for cell in cells]
