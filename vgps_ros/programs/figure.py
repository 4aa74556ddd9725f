"""Program `figure`: draws an experiment as Figure 1 of the paper, and sums it up in a table."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.experiments.cell_table import MethodResults, by_panel, read_table
from vgps_ros.experiments.cells import Cell, Panel
from vgps_ros.experiments.summary import summary, summary_table
from vgps_ros.search.methods import METHOD
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.views.comparison import ComparisonPanel, Curve, comparison
from vgps_ros.views.comparison_recording import record_comparison
from vgps_ros.views.plots import save
from vgps_ros.views.run_record import RunRecord, read_results
from vgps_ros.views.table_console import table_console

_PICTURES = ("figure1.png", "figure1.svg")
_RECORDING = "figure1.rrd"
_SUMMARY = "summary.csv"


def figure(root: Path, output: Path, *, average: str, overwrite: bool) -> list[dict[str, Any]]:
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
    existing = [p for p in (output / n for n in (*_PICTURES, _RECORDING, _SUMMARY)) if p.exists()]
    if existing and not overwrite:
        raise InvalidInputError(
            f"'{existing[0]}' exists already; name another --output, or give --overwrite."
        )
    output.mkdir(parents=True, exist_ok=True)
    for path in existing:
        path.unlink()
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    parser = argparse.ArgumentParser(
        prog="figure",
        description="Draws an experiment as Figure 1 of the paper: PNG, SVG and a Rerun recording; "
        f"prints a summary and writes it as {_SUMMARY}.",
    )
    parser.add_argument("experiment", type=Path, help="output folder of `experiment`")
    parser.add_argument("--output", type=Path, help="folder for the pictures; default: the same")
    parser.add_argument(
        "--average", choices=("mean", "median"), default="mean", help="of a policy's stochastic "
        "rollouts; a walker that thrashes after its fall outweighs all others in the mean"
    )  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="replace pictures that are there")
    parsed = parser.parse_args(arguments)
    output = parsed.output or parsed.experiment
    try:
        rows = figure(parsed.experiment, output, average=parsed.average, overwrite=parsed.overwrite)
    except (VgpsError, OSError) as error:
        sys.exit(f"figure: {error}")
    table_console(wide=True).print(summary_table(rows))
    print(f"Wrote {', '.join((*_PICTURES, _RECORDING, _SUMMARY))} to {output}.")
