# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Figure 1 of the paper: average costs of several methods by iteration, and the robots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from vgps_ros.core.records import Array
from vgps_ros.views.plots import draw_motion
from vgps_ros.views.run_record import RunRecord

CEILING = 20.0  # costs are drawn up to this multiple of the initial DDP solution's
_COLOURS = (
    "#1f5fbf", "#d62728", "#ff7f0e", "#2ca02c", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f",
)  # fmt: skip


@dataclass(frozen=True)
class Curve:
    """Costs of one method over the seeds.

    Attributes:
        stochastic: mean or median cost of the rollouts with noise, shape (S, K): S seeds and K
            iterations.
        deterministic: cost of the policy without noise, shape (S, K).
    """

    stochastic: Array
    deterministic: Array


@dataclass(frozen=True)
class ComparisonPanel:
    """One panel of the figure.

    Attributes:
        title: names the task and the size of the policy.
        ddp_cost: cost of the initial DDP solution, the median over the seeds.
        curves: the curve of each method, by its name.
    """

    title: str
    ddp_cost: float
    curves: Mapping[str, Curve]

    @property
    def ceiling(self) -> float:
        """The largest cost that is drawn."""
        return CEILING * self.ddp_cost

    @property
    def entity(self) -> str:
        """The name under which a Rerun recording holds the panel."""
        return self.title.replace(" ", "_").replace(",", "")


def colours(panels: Sequence[ComparisonPanel]) -> dict[str, str]:
    """Returns a colour for each method of the panels."""
    methods = list(dict.fromkeys(method for panel in panels for method in panel.curves))
    return {method: _COLOURS[i % len(_COLOURS)] for i, method in enumerate(methods)}


def comparison(
    panels: Sequence[ComparisonPanel], runs: Sequence[RunRecord], average: str = "mean"
) -> Figure:
    """Draws the panels, and beside them the robots under learned policies.

    Args:
        panels: the panels with their curves.
        runs: runs whose motions under the learned policy are drawn.
        average: "mean" or "median", which the legend calls the stochastic costs.
    """
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(5.2 * columns + 4.2, 1.2 + 3.4 * rows), layout="constrained")
    grid_spec = figure.add_gridspec(1, 2, width_ratios=[5.2 * columns, 4.2])
    left, right = (figure.add_subfigure(grid_spec[i]) for i in (0, 1))
    grid = left.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    colour_of = colours(panels)
    for axes, panel in zip(grid.flat, panels, strict=False):
        _draw_panel(axes, panel, colour_of)
    robots = right.subplots(max(len(runs), 1), 1, squeeze=False)[:, 0]
    for axes, run in zip(robots, runs, strict=False):
        if run.executed_states is not None and run.result is not None:
            draw_motion(axes, run, run.executed_states)
            axes.set_title(f"{run.result['task']}, {run.result['method']}", fontsize=10)
    if runs:
        handles, labels = robots[0].get_legend_handles_labels()
        right.legend(
            handles, [f"centre of mass: {label}" for label in labels], frameon=False,
            loc="outside lower center", fontsize=9,
        )  # fmt: skip
    else:
        robots[0].set_visible(False)
    styles = [
        Line2D([], [], color="0.3", label=f"stochastic ({average}; band: all seeds)"),
        Line2D([], [], color="0.3", linestyle="--", label="deterministic"),
        Line2D([], [], color="black", linewidth=1, linestyle=":", label="initial DDP solution"),
    ]
    methods = [Line2D([], [], color=c, linewidth=3, label=m) for m, c in colour_of.items()]
    left.legend(
        handles=[*methods, *styles], frameon=False, ncols=4, loc="outside upper center", fontsize=9
    )
    return figure


def _draw_panel(axes: Axes, panel: ComparisonPanel, colour_of: Mapping[str, str]) -> None:
    for method, curve in panel.curves.items():
        k = np.arange(1, curve.stochastic.shape[1] + 1)
        for costs, style in ((curve.stochastic, "-"), (curve.deterministic, "--")):
            drawn = np.minimum(costs, panel.ceiling)
            axes.plot(
                k, np.median(drawn, axis=0), style, color=colour_of[method], linewidth=1.4,
                alpha=0.9,
            )  # fmt: skip
            if style == "-":
                axes.fill_between(
                    k, drawn.min(axis=0), drawn.max(axis=0), color=colour_of[method], alpha=0.08,
                    linewidth=0,
                )  # fmt: skip
    axes.axhline(panel.ddp_cost, color="black", linewidth=1, linestyle=":")
    axes.axhspan(0.9 * panel.ceiling, 1.1 * panel.ceiling, color="0.9", zorder=0)
    axes.text(
        0.01, 0.985, f"{CEILING:g} × the DDP solution's, and more", transform=axes.transAxes,
        fontsize=7, va="top",
    )  # fmt: skip
    axes.set_yscale("log")
    axes.set_ylim(0.85 * panel.ddp_cost, 1.1 * panel.ceiling)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(x=0)
    axes.set_title(panel.title, fontsize=10)
    axes.set_xlabel("iteration")
    axes.set_ylabel("average cost")
