# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Pictures for reading without a viewer."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

from vgps_ros.core.records import Array
from vgps_ros.simulation.model import compile_model, deviation_names, hinge_names, state_names
from vgps_ros.views.robot_shape import RobotShape
from vgps_ros.views.run_record import RunRecord

_LEARNED, _DDP = "#1f5fbf", "black"
_POSES = 3  # drawn along a motion; more would overlap
_MARKED = 10  # iterations of a run that is so short that each is marked


def learning_curve(result: dict[str, Any]) -> Figure:
    """Draws the costs of a result.json by iteration, as Figure 1 of the paper does."""
    entries = result["iterations"]
    k = [entry["k"] for entry in entries]

    def series(name: str) -> Array:
        return np.array([e.get(name) for e in entries], dtype=float)  # None becomes NaN

    figure = Figure(figsize=(7, 4.6), layout="constrained")
    costs, alphas = figure.subplots(2, 1, sharex=True, height_ratios=[4, 1])
    is_short = len(k) <= _MARKED  # then each point is marked: a single one has no line
    for name, label, colour, line, marker in (
        ("stochastic_cost_mean", "stochastic policy", _LEARNED, "-", "o"),
        ("stochastic_cost_median", "its median rollout", _LEARNED, ":", "^"),
        ("deterministic_cost", "deterministic policy", _LEARNED, "--", "s"),
        ("ddp_cost", "DDP solution", "tab:orange", "-", "D"),
    ):
        width = 1.5 if name in ("stochastic_cost_mean", "deterministic_cost") else 1.0
        costs.plot(
            k,
            series(name),
            label=label,
            color=colour,
            linestyle=line,
            linewidth=width,
            marker=marker if is_short else "",
            markersize=5,
        )
    bound = -series("bound") / series("alpha")  # E_q[c] + KL ÷ α; an older result has none
    if np.isfinite(bound).any():
        costs.plot(k, bound, label="bound −L(q, θ) ÷ α", color="tab:green", linewidth=1.0,
                   marker="v" if is_short else "", markersize=5)  # fmt: skip
    costs.axhline(result["initial_ddp_cost"], color=_DDP, linewidth=1, label="initial DDP solution")
    costs.set_yscale("log")  # early iterations cost many times what later ones do
    low = min(result["initial_ddp_cost"], *np.nan_to_num(series("ddp_cost"), nan=np.inf))
    costs.set_ylim(bottom=0.9 * low)
    costs.yaxis.set_major_formatter("{x:g}")
    low, high = costs.get_ylim()
    costs.yaxis.set_minor_formatter("{x:g}" if high < 10 * low else NullFormatter())
    costs.tick_params(axis="y", which="minor", labelsize=8)
    costs.set_ylabel("cost over the horizon")
    units = " + ".join(map(str, result["hidden_units"]))
    costs.set_title(
        f"{result['task']}, {result['method']}, {units} hidden units, seed {result['seed']}"
    )
    figure.legend(frameon=False, ncols=3, loc="outside upper center")
    alphas.plot(k, series("alpha"), color="grey", marker="o" if is_short else "", markersize=4)
    alphas.set_ylim(0, 1.05 * max(series("alpha")))
    alphas.set_ylabel("α")
    alphas.xaxis.set_major_locator(MaxNLocator(integer=True))
    alphas.set_xlabel("iteration")
    if is_short:
        alphas.set_xlim(k[0] - 0.5, k[-1] + 0.5)
        alphas.set_xticks(k)
    return figure


def trajectory(run: RunRecord) -> Figure | None:
    """Draws each angle: q's mean and two standard deviations, and the executed one within.

    Returns:
        The figure; None if neither is known, or the robot has no hinge.
    """
    model = compile_model(run.mjcf)
    hinges = hinge_names(model)
    if not hinges or (run.mean_states is None and run.executed_states is None):
        return None
    in_x, in_dx = state_names(model), deviation_names(model)
    figure = Figure(figsize=(7, 1.2 + 1.3 * len(hinges)), layout="constrained")
    rows = figure.subplots(len(hinges), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(rows, hinges, strict=True):
        _draw_angle(axes, run, *(names.index(f"{name}/position") for names in (in_x, in_dx)))
        axes.set_ylabel(f"{name}\n[rad]")
        axes.margins(x=0)
    rows[-1].set_xlabel("time [s]")
    handles, labels = rows[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=3, loc="outside upper center")
    return figure


def _draw_angle(axes: Axes, run: RunRecord, i: int, i_dx: int) -> None:
    """Draws coordinate i of the states, which is coordinate i_dx of their deviations."""
    if run.mean_states is not None and run.state_covariances is not None:
        mean = run.mean_states[:, i]
        deviation = np.sqrt(run.state_covariances[:, i_dx, i_dx].clip(0.0))
        time = run.time_step * np.arange(len(mean))
        axes.fill_between(
            time,
            mean - 2.0 * deviation,
            mean + 2.0 * deviation,
            color="tab:orange",
            alpha=0.35,
            linewidth=0,
            label="q: mean ± 2 sd",
        )
        axes.plot(time, mean, color="tab:orange", linewidth=1, label="q: mean")
    if run.executed_states is not None:
        executed = run.executed_states[:, i]
        time = run.time_step * np.arange(len(executed))
        axes.plot(time, executed, color=_LEARNED, linewidth=1, label="executed policy")


def motion(run: RunRecord) -> Figure | None:
    """Draws the robot at several times of its motion, and the paths of its centre of mass.

    Returns:
        The figure; None if no motion under the policy is known.
    """
    if run.executed_states is None:
        return None
    figure = Figure(figsize=(9, 2.3), layout="constrained")
    draw_motion(figure.subplots(), run, run.executed_states)
    figure.legend(frameon=False, ncols=2, loc="outside upper center")
    return figure


def draw_motion(axes: Axes, run: RunRecord, states: Array) -> None:
    """Draws the robot in several of its states (N+1, n_x), and the centre of mass's paths."""
    shape = RobotShape(compile_model(run.mjcf))
    plane = list(shape.plane)
    for t in np.linspace(0, len(states) - 1, _POSES).astype(int):
        for ends in shape.axes(states[t])[:, :, plane]:
            axes.plot(
                ends[:, 0], ends[:, 1], color="0.55", alpha=0.3 + 0.5 * t / len(states),
                linewidth=5, solid_capstyle="round", zorder=1,
            )  # fmt: skip
        limbs = shape.axes(states[t])[:, :, plane].reshape(-1, 2)
        top = limbs[:, 0].mean(), limbs[:, 1].max()
        time = f"{t * run.time_step:.1f} s"
        axes.annotate(time, top, (0, 5), textcoords="offset points", ha="center", fontsize=8)
    if run.initial_states is not None:
        path = shape.path(run.initial_states)[:, plane]
        axes.plot(path[:, 0], path[:, 1], color=_DDP, linewidth=1.2, label="initial DDP solution")
    path = shape.path(states)[:, plane]
    axes.plot(path[:, 0], path[:, 1], color=_LEARNED, linewidth=2, label="learned policy")
    axes.set_aspect("equal")
    axes.margins(0.02, 0.35)
    axes.set_xlabel(f"{'xyz'[plane[0]]} [m]")
    axes.set_ylabel(f"{'xyz'[plane[1]]} [m]")


def save(figure: Figure, path: Path) -> None:
    """Writes a figure to a file; its ending says in which format."""
    figure.savefig(path, dpi=130, bbox_inches="tight")
