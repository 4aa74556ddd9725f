"""Pictures for reading without a viewer."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from vgps_ros.core.records import Array
from vgps_ros.tasks import Task
from vgps_ros.views.robot_shape import RobotShape

_LEARNED, _DDP = "#1f5fbf", "black"
_POSES = 3  # drawn along a motion; more would overlap


def learning_curve(result: dict[str, Any]) -> Figure:
    """Draws the costs of a result.json by iteration, as Figure 1 of the paper does."""
    entries = result["iterations"]
    k = [entry["k"] for entry in entries]

    def series(name: str) -> Array:
        return np.array([np.nan if e[name] is None else e[name] for e in entries], dtype=float)

    figure = Figure(figsize=(7, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    costs, alphas = figure.subplots(2, 1, sharex=True, height_ratios=[4, 1])
    costs.plot(k, series("stochastic_cost_mean"), color=_LEARNED, label="stochastic policy")
    costs.plot(
        k,
        series("deterministic_cost"),
        color=_LEARNED,
        linestyle="--",
        label="deterministic policy",
    )
    costs.plot(k, series("ddp_cost"), color="tab:orange", linewidth=1, label="DDP solution")
    costs.axhline(result["initial_ddp_cost"], color=_DDP, linewidth=1, label="initial DDP solution")
    costs.set_yscale("log")  # early iterations cost many times what later ones do
    low = min(result["initial_ddp_cost"], *np.nan_to_num(series("ddp_cost"), nan=np.inf))
    costs.set_ylim(bottom=0.9 * low)
    costs.yaxis.set_major_formatter("{x:g}")
    costs.yaxis.set_minor_formatter("{x:g}")
    costs.tick_params(axis="y", which="minor", labelsize=8)
    costs.set_ylabel("cost over the horizon")
    units = " + ".join(map(str, result["hidden_units"]))
    costs.set_title(f"{result['task']}, {units} hidden units, seed {result['seed']}")
    costs.legend(frameon=False)
    alphas.plot(k, series("alpha"), color="grey")
    alphas.set_ylim(0, 1.05 * max(series("alpha")))
    alphas.set_ylabel("α")
    alphas.set_xlabel("iteration of Algorithm 1")
    return figure


def motion(task: Task, states: Array, initial_states: Array | None = None) -> Figure:
    """Draws a robot at several times of a motion, and the path of its centre of mass.

    Args:
        task: whose robot.
        states: the learned policy's motion, shape (T+1, n_x).
        initial_states: the initial DDP solution's, for comparison.
    """
    shape = RobotShape(task.dynamics.model)
    figure = Figure(figsize=(9, 2.3), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for t in np.linspace(0, len(states) - 1, _POSES).astype(int):
        for ends in shape.axes(states[t]):
            axes.plot(
                ends[:, 0], ends[:, 1], color="0.55", alpha=0.3 + 0.5 * t / len(states),
                linewidth=5, solid_capstyle="round", zorder=1,
            )  # fmt: skip
        x, y, _ = shape.centre_of_mass(states[t])
        time = f"{t * task.dynamics.time_step:.1f} s"
        axes.annotate(time, (x, y), (0, 34), textcoords="offset points", ha="center", fontsize=8)
    if initial_states is not None:
        path = shape.path(initial_states)
        axes.plot(path[:, 0], path[:, 1], color=_DDP, linewidth=1.2, label="initial DDP solution")
    path = shape.path(states)
    axes.plot(path[:, 0], path[:, 1], color=_LEARNED, linewidth=2, label="learned policy")
    axes.set_aspect("equal")
    axes.margins(0.02, 0.35)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    figure.legend(frameon=False, ncols=2, loc="outside upper center")
    return figure


def plot_learning_curve(result: dict[str, Any], path: Path) -> None:
    """Writes the learning curve of a result.json to a picture."""
    learning_curve(result).savefig(path, dpi=150, bbox_inches="tight")


def plot_motion(task: Task, states: Array, path: Path, initial_states: Array | None = None) -> None:
    """Writes a motion to a picture; see `motion`."""
    motion(task, states, initial_states).savefig(path, dpi=150, bbox_inches="tight")
