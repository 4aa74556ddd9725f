# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A training by iteration: its costs as Figure 1 of the paper draws them, and TensorBoard's files.

The package tensorboardX, which requirements/tensorboard.txt pins, writes the event files, which
TensorBoard draws as they come.
"""

import math
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.records import Array
from vgps_ros.search.metrics import IterationMetrics

_LEARNED, _Q = "#1f5fbf", "#ff9f1c"  # they differ in grey, too
_LARGEST = 1e100  # a cost beyond it is not drawn: its multiples may overflow
_LONGEST_TITLE = 100  # characters
_SHORT = 10  # iterations of a run in which each point is marked; a single one has no line
_CURVES = (
    # metric of an iteration, its label, colour, kind of line, width, marker
    ("stochastic_cost_mean", "stochastic policy", _LEARNED, "-", 1.8, "o"),
    ("stochastic_cost_median", "its median rollout", _LEARNED, ":", 1.0, "^"),
    ("deterministic_cost", "deterministic policy", _LEARNED, "--", 1.4, "s"),
    ("ddp_cost", "DDP solution", _Q, "-", 1.4, "D"),
)


def learning_curve(result: dict[str, Any]) -> Figure:
    """Draws the costs of a result.json as multiples of the initial DDP solution's.

    The inset repeats the last half of a run on a linear axis: the curves lie close together there.
    """
    entries = result["iterations"]
    k = np.array([entry["k"] for entry in entries])
    curves = _curves(result)
    figure = Figure(figsize=(7, 4.6), layout="constrained")
    costs, alphas = figure.subplots(2, 1, sharex=True, height_ratios=[4, 1])
    is_short = len(k) <= _SHORT
    _draw(costs, k, curves, marked=is_short)
    drawn = np.concatenate([values for _, values, _ in curves])
    drawn = drawn[np.isfinite(drawn) & (drawn > 0)]
    high = max(drawn, default=1.0)
    if high > 0 and len(drawn) == sum(np.isfinite(values).sum() for _, values, _ in curves):
        costs.set_yscale("log")  # early iterations cost many times what later ones do
        low, top = costs.set_ylim(0.95 * min([1.0, *drawn]), 1.1 * max(1.0, high))
        narrow = (1, 1.2, 1.5, 2, 3, 5, 7)
        multiples = narrow if top < 7 * low else (1, 2, 5) if top < 300 * low else (1,)
        costs.yaxis.set_major_locator(LogLocator(subs=multiples, numticks=8))
        costs.yaxis.set_major_formatter("{x:g}")
        costs.yaxis.set_minor_locator(NullLocator())
    costs.set_ylabel("cost ÷ initial DDP's")
    units = " + ".join(map(str, result["hidden_units"]))
    title = f"{result['task']}, {result['method']}, {units} hidden units, seed {result['seed']}"
    costs.set_title(title[:_LONGEST_TITLE], parse_math=False)
    if not is_short:
        _draw_end(costs, k, curves)
    figure.legend(*costs.get_legend_handles_labels(), frameon=False, ncols=3,
                  loc="outside upper center")  # fmt: skip
    alpha = np.array([entry["alpha"] for entry in entries], dtype=float)
    alpha = np.where(np.abs(alpha) < _LARGEST, alpha, np.nan)
    alphas.plot(k, alpha, color="grey", marker="o" if is_short else "", markersize=4)
    alphas.set_ylim(0, 1.05 * max([1e-9, *alpha[alpha > 0]]))
    alphas.set_ylabel("α")
    alphas.set_xlabel("iteration")
    alphas.xaxis.set_major_locator(MaxNLocator(6, integer=True, steps=[1, 2, 5, 10]))
    if is_short:
        alphas.set_xlim(k[0] - 0.5, k[-1] + 0.5)
        alphas.set_xticks(k)
    return figure


def _curves(result: dict[str, Any]) -> list[tuple[str, Array, dict[str, Any]]]:
    """Returns the label, the values as multiples of the initial cost, and the style of each."""
    initial = result["initial_ddp_cost"] or 1.0  # a cost of 0 has no multiples
    if not abs(initial) < _LARGEST:
        initial = 1.0

    def series(name: str) -> Array:
        values = np.array([entry.get(name) for entry in result["iterations"]], dtype=float)
        return np.where(np.abs(values) < _LARGEST, values, np.nan)  # None is NaN already

    curves = []
    for name, label, colour, line, width, marker in _CURVES:
        style = {"color": colour, "linestyle": line, "linewidth": width, "marker": marker}
        curves.append((label, series(name) / initial, style))
    with np.errstate(divide="ignore", invalid="ignore"):  # a run whose α is 0 has none
        bound = -series("bound") / series("alpha") / initial  # E_q[c] + KL ÷ α
    if np.isfinite(bound).any():  # it may be infinite
        style = {"color": "tab:green", "linestyle": "-.", "linewidth": 1.0, "marker": "v"}
        curves.append(("bound −L(q, θ) ÷ α", bound, style))
    return curves


def _draw(
    axes: Axes, k: Array, curves: list[tuple[str, Array, dict[str, Any]]], *, marked: bool
) -> None:
    for label, values, style in curves:
        axes.plot(
            k, values, label=label, markersize=5, **(style if marked else style | {"marker": ""})
        )
    axes.axhline(1.0, color="black", linewidth=1, label="initial DDP solution")


def _draw_end(axes: Axes, k: Array, curves: list[tuple[str, Array, dict[str, Any]]]) -> None:
    """Repeats the last half of the curves above their end, where that corner is empty."""
    half = k >= k[len(k) // 2]
    shown = np.concatenate([values[half] for label, values, _ in curves if "bound" not in label])
    shown = shown[np.isfinite(shown)]
    low, high = min(1.0, *shown), max(1.0, *shown)
    top = axes.get_ylim()[1]
    if high > top**0.5:  # the end is no lower than the middle of the logarithmic axis
        return
    inset = axes.inset_axes((0.45, 0.42, 0.53, 0.54))
    _draw(
        inset,
        k[half],
        [(label, values[half], style) for label, values, style in curves],
        marked=False,
    )
    margin = 0.08 * (high - low) + 0.005
    inset.set_ylim(low - margin, high + margin)
    inset.margins(x=0)
    inset.xaxis.set_major_locator(MaxNLocator(3, integer=True, steps=[1, 2, 5, 10]))
    inset.yaxis.set_major_locator(MaxNLocator(4))
    inset.tick_params(labelsize=8)


class EventLog:
    """Writes one event file. What is not finite is left out.

    Args:
        folder: folder of the files. One that is there already stays; TensorBoard shows of it what
            comes before the first iteration of this one.

    Raises:
        VgpsError: the package is not installed.
    """

    def __init__(self, folder: Path):
        try:
            from tensorboardX import SummaryWriter
        except ModuleNotFoundError as error:
            raise VgpsError(
                f"--tensorboard needs the package {error.name}: pip install -r "
                "requirements/tensorboard.txt."
            ) from error
        self._open = partial(SummaryWriter, str(folder))
        self._writer: Any = None

    def iteration(self, metrics: IterationMetrics) -> None:
        """Writes an iteration's metrics, and has them on disk when it returns."""
        if self._writer is None:
            self._writer = self._open(purge_step=metrics.k)
        for field in fields(IterationMetrics):
            value = getattr(metrics, field.name)
            many = isinstance(value, tuple)
            for i, number in enumerate(value if many else (value,)):
                if isinstance(number, int | float) and math.isfinite(number) and field.name != "k":
                    name = f"{field.name}/{i}" if many else field.name
                    self._writer.add_scalar(name, number, metrics.k)
        self._writer.flush()

    def close(self) -> None:
        """Closes the file."""
        if self._writer is not None:
            self._writer.close()
