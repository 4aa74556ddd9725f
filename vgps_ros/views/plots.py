# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Pictures of a motion, for reading without a viewer."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from vgps_ros.core.records import Array
from vgps_ros.search.run_record import RunRecord
from vgps_ros.simulation.model import compile_model, deviation_names, hinge_names, state_names
from vgps_ros.views.departure import Departure, find_departure
from vgps_ros.views.robot_shape import RobotShape

_LEARNED, _Q, _DDP = "#1f5fbf", "#ff9f1c", "black"  # they differ in grey, too
_PHASE = ("position", "velocity")
_POSES = 9  # drawn along a motion
_LABELLED = 4  # every which pose has its time above it


def trajectory(run: RunRecord) -> Figure | None:
    """Draws each angle: q's mean and two standard deviations, and the executed one within.

    A vertical line stands where the executed motion leaves the tube of an angle.

    Returns:
        The figure; None if neither is known, or the robot has no hinge.
    """
    model = compile_model(run.mjcf)
    hinges = hinge_names(model)
    if not hinges or (run.mean_states is None and run.executed_states is None):
        return None
    in_x, in_dx = (
        [names.index(f"{name}/position") for name in hinges]
        for names in (state_names(model), deviation_names(model))
    )
    figure = Figure(figsize=(7, 1.4 + 1.3 * len(hinges)), layout="constrained")
    rows = figure.subplots(len(hinges), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name, i, i_dx in zip(rows, hinges, in_x, in_dx, strict=True):
        _draw_angle(axes, run, i, i_dx)
        axes.set_ylabel(f"{name}\n[rad]")
        axes.margins(x=0)
    if left := _departure(run, in_x, in_dx):
        for axes in rows:
            axes.axvline(left.time, color="0.3", linewidth=1, linestyle=(0, (4, 3)))
        rows[0].set_title(f"The executed policy {left}.", fontsize=9, loc="left")
    rows[-1].set_xlabel("time [s]")
    handles, labels = rows[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=3, loc="outside upper center")
    return figure


def _departure(run: RunRecord, in_x: list[int], in_dx: list[int]) -> Departure | None:
    """Returns where the executed angles leave their tubes, if all of them are known."""
    if run.mean_states is None or run.state_covariances is None or run.executed_states is None:
        return None
    deviations = np.sqrt(run.state_covariances[:, in_dx, in_dx].clip(0.0))
    angles = run.executed_states[:, in_x], run.mean_states[:, in_x]
    return find_departure(*angles, deviations, run.time_step)


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
            color=_Q,
            alpha=0.4,
            linewidth=0,
            label="q: mean ± 2 sd",
        )
        axes.plot(time, mean, color=_Q, linewidth=1.2, label="q: mean")
    if run.executed_states is not None:
        executed = run.executed_states[:, i]
        time = run.time_step * np.arange(len(executed))
        axes.plot(time, executed, color=_LEARNED, linewidth=1, label="executed policy")


def phase_portrait(run: RunRecord) -> Figure | None:
    """Draws the velocity of each hinge over its angle, darker with time: a gait is a closed loop.

    Returns:
        The figure; None if no motion under the policy is known, or the robot has no hinge.
    """
    model = compile_model(run.mjcf)
    hinges, names = hinge_names(model), state_names(model)
    if run.executed_states is None or not hinges:
        return None
    columns = min(4, len(hinges))
    lines = -(-len(hinges) // columns)
    figure = Figure(figsize=(2.2 * columns, 2.1 * lines + 0.5), layout="constrained")
    cells = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes in cells[len(hinges) :]:
        axes.set_axis_off()
    shade = np.linspace(0.0, 1.0, len(run.executed_states) - 1)
    for axes, name in zip(cells, hinges, strict=False):
        loop = run.executed_states[:, [names.index(f"{name}/{kind}") for kind in _PHASE]]
        pieces = list(np.stack([loop[:-1], loop[1:]], axis=1))
        drawn = LineCollection(pieces, cmap="Blues", linewidths=1)
        drawn.set_array(0.35 + 0.65 * shade)
        drawn.set_clim(0.0, 1.0)
        axes.add_collection(drawn)
        axes.plot(*loop[0], marker="o", color="black", markersize=4)
        axes.set_title(name, fontsize=9)
        axes.margins(0.08)
        axes.tick_params(labelsize=8)
    seconds = run.time_step * (len(run.executed_states) - 1)
    figure.suptitle(f"{seconds:.3g} s, from the dot on, darker with time", fontsize=9)
    figure.supxlabel("angle [rad]", fontsize=9)
    figure.supylabel("velocity [rad/s]", fontsize=9)
    return figure


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
    for i, t in enumerate(np.linspace(0, len(states) - 1, _POSES).astype(int)):
        limbs = shape.axes(states[t])[:, :, plane]
        for ends in limbs:
            axes.plot(
                ends[:, 0], ends[:, 1], color=str(0.85 - 0.5 * i / (_POSES - 1)),
                linewidth=4, solid_capstyle="round", zorder=1,
            )  # fmt: skip
        if i % _LABELLED == 0:
            place, above = limbs[..., 0].mean(), ("data", "axes fraction")
            axes.annotate(
                f"{t * run.time_step:.1f} s", (place, 0.97), xycoords=above, ha="center", va="top"
            )
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
