# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Figure 1 of the paper: costs of several methods by iteration, and the robots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import rerun as rr
import rerun.blueprint as rrb
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from benchmarks.figure1.cells import Cell, Panel
from benchmarks.figure1.statistics import (
    CEILING,
    Band,
    Results,
    improvement,
    iqm,
    last_costs,
    multiples,
    print_rows,
    profile,
    summary,
)
from benchmarks.figure1.table import Columns, by_panel, read_table
from vgps_ros.core.records import Array
from vgps_ros.programs.command_line import refuse_existing
from vgps_ros.search.run_record import RunRecord, read_results
from vgps_ros.search.settings import METHOD
from vgps_ros.simulation.model import compile_model
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.views.plots import draw_motion, save
from vgps_ros.views.recording import ITERATION, Recording
from vgps_ros.views.robot_shape import RobotShape

_LOWEST = 0.85  # the lowest multiple that is drawn
# Colour, line and marker of each curve. In grey, lines and markers tell them apart.
_STYLES = (
    ("#0b3c8c", "-", "o"), ("#d62728", "-", "s"), ("#ff7f0e", "--", "D"), ("#2ca02c", "-", "^"),
    ("#9467bd", "-", "v"), ("#8c564b", "--", "P"), ("#e377c2", ":", "X"), ("#7f7f7f", "-.", "*"),
    ("#17a0c0", "--", "h"),
)  # fmt: skip
_KINDS = ("deterministic", "stochastic")


@dataclass(frozen=True)
class Curve:
    """Costs of one method by iteration, as multiples of the initial DDP solution's, shape (K,).

    Attributes:
        stochastic: of the policy with its noise.
        deterministic: of the policy without noise.
    """

    stochastic: Band
    deterministic: Band


@dataclass(frozen=True)
class ComparisonPanel:
    """One panel of the figure.

    Attributes:
        title: names the task and the size of the policy.
        curves: the curve of each method, by its name.
    """

    title: str
    curves: Mapping[str, Curve]

    @property
    def entity(self) -> str:
        """The name under which a Rerun recording holds the panel."""
        return self.title.replace(" ", "_").replace(",", "")


def styles(methods: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Returns how each method's lines are drawn, as matplotlib's colour, linestyle and marker."""
    names = ("color", "linestyle", "marker")
    return {
        method: dict(zip(names, _STYLES[i % len(_STYLES)], strict=True))
        for i, method in enumerate(dict.fromkeys(methods))
    }


def comparison(
    panels: Sequence[ComparisonPanel], runs: Sequence[RunRecord], average: str = "mean"
) -> Figure:
    """Draws the panels, and beside them the robots under learned policies.

    Args:
        panels: the panels with their curves.
        runs: runs whose motions under the learned policy are drawn.
        average: "mean" or "median" of the rollouts with noise, whose costs are drawn.
    """
    count, widths = len(panels), [3.6 * len(panels), 4.0][: 2 if runs else 1]
    figure = Figure(figsize=(sum(widths), 8.0), layout="constrained")
    grid_spec = figure.add_gridspec(1, len(widths), width_ratios=widths)
    left = figure.add_subfigure(grid_spec[0])
    grid = left.subplots(2, count, squeeze=False, sharex="col", sharey=True)
    style_of = styles([method for panel in panels for method in panel.curves])
    for row, kind in zip(grid, _KINDS, strict=True):
        for axes, panel in zip(row, panels, strict=True):
            curves = {method: getattr(curve, kind) for method, curve in panel.curves.items()}
            _draw_curves(axes, curves, style_of)
    for axes, panel in zip(grid[0], panels, strict=True):
        axes.set_title(panel.title, fontsize=10)
    for axes in grid[1]:
        axes.set_xlabel("iteration")
    grid[0, 0].set_ylabel("without noise, cost ÷ DDP's")
    grid[1, 0].set_ylabel(f"with noise ({average} rollout), cost ÷ DDP's")
    handles = [Line2D([], [], label=method, **style) for method, style in style_of.items()]
    ddp = Line2D([], [], color="black", linewidth=1, linestyle=":", label="initial DDP solution")
    left.legend(
        handles=[*handles, ddp], frameon=False, ncols=5, loc="outside upper center", fontsize=9
    )
    if runs:
        _draw_robots(figure.add_subfigure(grid_spec[1]), runs)
    return figure


def _draw_robots(figure: SubFigure, runs: Sequence[RunRecord]) -> None:
    robots = figure.subplots(len(runs), 1, squeeze=False)[:, 0]
    for axes, run in zip(robots, runs, strict=True):
        if run.executed_states is not None and run.result is not None:
            draw_motion(axes, run, run.executed_states)
            axes.set_title(f"{run.result['task']}, {run.result['method']}", fontsize=10)
    handles, labels = robots[0].get_legend_handles_labels()
    figure.legend(
        handles, [f"centre of mass: {label}" for label in labels], frameon=False,
        loc="outside lower center", fontsize=9,
    )  # fmt: skip


def _draw_curves(
    axes: Axes, curves: Mapping[str, Band], style_of: Mapping[str, Mapping[str, Any]]
) -> None:
    for i, (method, band) in enumerate(curves.items()):
        k, style = np.arange(1, len(band.middle) + 1), style_of[method]
        axes.plot(
            k, band.middle, linewidth=1.4, markersize=4, markevery=(i % 5, 5), alpha=0.9, **style
        )
        axes.fill_between(k, band.low, band.high, color=style["color"], alpha=0.12, linewidth=0)
    axes.axhline(1.0, color="black", linewidth=1, linestyle=":")
    axes.axhspan(0.9 * CEILING, 1.1 * CEILING, color="0.9", zorder=0)
    axes.annotate(
        f"{CEILING:g} and more", (0.02, 0.88 * CEILING), xycoords=("axes fraction", "data"),
        fontsize=7, va="top",
    )  # fmt: skip
    axes.set_yscale("log")
    axes.set_ylim(_LOWEST, 1.1 * CEILING)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(x=0)


def profiles(levels: Array, shares: Mapping[str, Mapping[str, Band]]) -> Figure:
    """Draws which share of the seeds of all panels ends at each cost or below.

    Args:
        levels: costs as multiples of the initial DDP solution's, shape (L,).
        shares: by "deterministic" and "stochastic", by method: the shares, shape (L,).
    """
    figure = Figure(figsize=(10.0, 4.4), layout="constrained")
    row = figure.subplots(1, 2, sharey=True)
    style_of = styles([method for each in shares.values() for method in each])
    titles = ("without noise", "with noise")
    for axes, kind, title in zip(row, _KINDS, titles, strict=True):
        for i, (method, band) in enumerate(shares[kind].items()):
            style, every = style_of[method], (2 * i, 20)
            axes.plot(levels, band.middle, markersize=4, markevery=every, label=method, **style)
            axes.fill_between(
                levels, band.low, band.high, color=style["color"], alpha=0.12, linewidth=0
            )
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("cost ÷ DDP's, of the last iterations")
        axes.margins(x=0)
    row[0].set_ylabel("share of the seeds that end there or below")
    figure.legend(
        *row[0].get_legend_handles_labels(), frameon=False, ncols=5, loc="outside upper center",
        fontsize=9,
    )  # fmt: skip
    return figure


_PATHS = {"learned": (31, 95, 191), "initial_ddp": (0, 0, 0)}


def record_comparison(
    panels: Sequence[ComparisonPanel], runs: Sequence[RunRecord], path: Path
) -> None:
    """Writes the middle of each curve over the seeds, and the paths of the robots.

    Raises:
        InvalidInputError: the file exists, or cannot be written.
    """
    recording = Recording(path)
    style_of = styles([method for panel in panels for method in panel.curves])
    for panel in panels:
        for method, curve in panel.curves.items():
            colour = [round(255 * part) for part in to_rgb(style_of[method]["color"])]
            for name, width in (("stochastic", 2.0), ("deterministic", 1.0)):
                middle = getattr(curve, name).middle
                line = rr.SeriesLines(colors=[colour], names=f"{method} {name}", widths=width)
                _record_costs(recording, f"{panel.entity}/{method}/{name}", line, middle)
        line = rr.SeriesLines(colors=[(0, 0, 0)], names="initial DDP solution")
        ones = np.ones(len(middle))
        _record_costs(recording, f"{panel.entity}/initial_ddp", line, ones)
    names = [_record_paths(recording, run) for run in runs]
    views = [
        rrb.TimeSeriesView(
            origin=panel.entity,
            name=f"{panel.title}: cost ÷ initial DDP solution's, by iteration",
            axis_y=rrb.ScalarAxis(range=(0.0, 4.0), zoom_lock=False),
        )
        for panel in panels
    ] + [
        rrb.Spatial3DView(origin=f"robots/{name}", name=f"{name}: centre of mass [m]")
        for name in names
    ]
    recording.lay_out(
        rrb.Blueprint(rrb.Grid(*views), rrb.TimePanel(timeline=ITERATION), collapse_panels=True)
    )
    recording.close()


def _record_costs(recording: Recording, entity: str, line: rr.SeriesLines, costs: Array) -> None:
    recording.log_static(entity, line)
    times = rr.TimeColumn(ITERATION, sequence=np.arange(1, len(costs) + 1))
    recording.send_series(entity, [times], costs[:, None])


def _record_paths(recording: Recording, run: RunRecord) -> str:
    """Draws the paths of the centre of mass in a run and returns the robot's name."""
    assert run.result is not None
    name = str(run.result["task"])
    shape = RobotShape(compile_model(run.mjcf))
    for path, states in (("learned", run.executed_states), ("initial_ddp", run.initial_states)):
        if states is not None:
            strip = rr.LineStrips3D([shape.path(states)], colors=_PATHS[path], labels=path)
            recording.log_static(f"robots/{name}/{path}", strip)
    return name


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
