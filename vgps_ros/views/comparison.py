# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Figure 1 of the paper: costs of several methods by iteration, and the robots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from vgps_ros.core.records import Array
from vgps_ros.views.plots import draw_motion
from vgps_ros.views.run_record import RunRecord

CEILING = 20.0  # costs are counted and drawn up to this multiple of the initial DDP solution's
_LOWEST = 0.85  # the lowest multiple that is drawn
# Colour, line and marker of each curve. In grey, lines and markers tell them apart.
_STYLES = (
    ("#0b3c8c", "-", "o"), ("#d62728", "-", "s"), ("#ff7f0e", "--", "D"), ("#2ca02c", "-", "^"),
    ("#9467bd", "-", "v"), ("#8c564b", "--", "P"), ("#e377c2", ":", "X"), ("#7f7f7f", "-.", "*"),
    ("#17a0c0", "--", "h"),
)  # fmt: skip
_KINDS = ("deterministic", "stochastic")


@dataclass(frozen=True)
class Band:
    """A statistic over the seeds with its interval, each of the same shape."""

    middle: Array
    low: Array
    high: Array


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
