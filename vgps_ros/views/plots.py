# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Pictures of a motion and of what it survives, for reading without a viewer."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vgps_ros.core.records import Array
from vgps_ros.search.commanded_motion import CommandedMotion
from vgps_ros.search.identification import IdentifiedRobot
from vgps_ros.search.judgement import interval
from vgps_ros.search.robustness import ENOUGH, KINDS
from vgps_ros.search.run_record import RunRecord
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import (
    actuated_joint_names,
    compile_model,
    deviation_names,
    hinge_names,
    state_names,
)
from vgps_ros.views.robot_shape import RobotShape

_LEARNED, _Q, _DDP = "#1f5fbf", "#ff9f1c", "black"  # they differ in grey, too
_POSES = 9  # drawn along a motion
_LABELLED = 4  # one pose of so many has its time above it
_SMOOTH = 0.3  # time over which what was driven is averaged, where no clock tells a period [s]
_PANELS = 4  # beside each other
_ROWS, _WINDOWS = 6, 10  # of joints below each other, and of windows beside each other
# Lines of several policies differ in shape too, so that they can be told apart in grey.
_LINES = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)))
_MARKERS = ("o", "s", "^", "D", "v")
_COLOURS = ("#1f5fbf", "black", "tab:orange", "tab:green", "tab:red")


def save(figure: Figure, path: Path) -> None:
    """Writes a figure to a file; its ending says in which format."""
    figure.savefig(path, dpi=130, bbox_inches="tight")


def trajectory(run: RunRecord) -> Figure | None:
    """Draws each angle: q's mean and two standard deviations, and the executed one within.

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
        low, high = mean - 2.0 * deviation, mean + 2.0 * deviation
        label = "q: mean ± 2 sd"
        axes.fill_between(time, low, high, color=_Q, alpha=0.4, linewidth=0, label=label)
        axes.plot(time, mean, color=_Q, linewidth=1.2, label="q: mean")
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


def driving(driven: CommandedMotion) -> Figure:
    """Draws what a robot did beside what it was told: its path from above, and each command."""
    has_path = driven.asked_path is not None and driven.driven_path is not None
    rows = len(driven.commands)
    size = (10 if has_path else 7, max(3.0, 1.0 + 1.3 * rows))
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.add_gridspec(rows, 1 + has_path, width_ratios=[1, 1.3][-1 - has_path :])
    if driven.asked_path is not None and driven.driven_path is not None:
        axes = figure.add_subplot(grid[:, 0])
        axes.plot(*driven.asked_path[:, :2].T, color=_Q, linewidth=3)
        axes.plot(*driven.driven_path[:, :2].T, color=_LEARNED, linewidth=1.2)
        axes.plot(*driven.driven_path[0, :2], marker="o", color="black", markersize=4)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        drift = f"From the dot on; the end is off by {driven.drift:.2f} m."
        axes.set_title(drift, fontsize=9, loc="left")
    window = round((1.0 / driven.frequency if driven.frequency else _SMOOTH) / driven.time_step)
    window = max(1, min(window, len(driven.done)))
    time = driven.time_step * np.arange(len(driven.asked))
    for i, (command, error) in enumerate(zip(driven.commands, driven.errors.values(), strict=True)):
        axes = figure.add_subplot(grid[i, -1])
        mean = np.convolve(driven.done[:, i], np.full(window, 1.0 / window), "valid")
        centre = time[: len(mean)] + 0.5 * (window - 1) * driven.time_step
        seconds = f"{window * driven.time_step:.2g} s"
        axes.plot(time, driven.asked[:, i], color=_Q, linewidth=3, label="asked")
        axes.plot(centre, mean, color=_LEARNED, linewidth=1.2, label=f"driven, mean over {seconds}")
        axes.set_ylabel(f"{command.name}\n[{command.unit}]")
        axes.set_title(f"rms error {error:.3f} {command.unit}", fontsize=9, loc="right", pad=2)
        axes.margins(x=0)
        axes.tick_params(labelbottom=i == rows - 1)
    axes.set_xlabel("time [s]")
    shown = axes.get_legend_handles_labels()
    figure.legend(*shown, frameon=False, ncols=2, loc="outside upper center")
    return figure


def predictions(found: IdentifiedRobot) -> Figure:
    """Draws joints as they were measured beside what the model predicted, and what was found does.

    Each window begins anew at what was measured.
    """
    layout, count = state_layout(found.model), min(len(found.time), _WINDOWS)
    time = found.time[:count] - found.time[:count, :1]
    time = time + np.arange(count)[:, None] * time[:, -1:].max()
    joints = [name for name in actuated_joint_names(found.model) if name in layout.joints]
    columns = -(-len(joints) // _ROWS)
    rows = -(-len(joints) // columns)
    figure = Figure(figsize=(1 + 5 * columns, 1 + 1.4 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for axes in panels.T.flat[len(joints) :]:
        axes.remove()
    for axes, joint in zip(panels.T.flat, joints, strict=False):
        place = layout.names.index(f"{joint}/position")
        for t, *lines in zip(time, found.measured, found.before, found.after, strict=False):
            measured, before, after = (line[:, place] for line in lines)
            axes.plot(t, measured, ".", color=_DDP, markersize=2.5, label="measured")
            axes.plot(t, before, color=_Q, linewidth=1.2, label="the model predicts")
            axes.plot(t, after, color=_LEARNED, linewidth=1, label="what was found predicts")
            axes.axvline(t[-1], color="0.9", linewidth=0.8)
        axes.set_title(joint, fontsize=8, loc="left", pad=2)
        axes.margins(x=0)
    figure.supylabel("positions of joints [rad, m]", fontsize=9)
    figure.supxlabel(
        "time in the windows that did not take part, one after another [s]", fontsize=9
    )
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles[:3], labels[:3], frameon=False, ncols=3, loc="outside upper center")
    return figure


def survival_curves(found: Mapping[str, Mapping[str, Any]], rollouts: int) -> Figure:
    """Draws a panel for each kind of disturbance, from the results of `robustness` by label.

    From the number of rollouts for each value the bars of 95 % follow (Wilson).
    """
    kinds = [kind for kind in KINDS if any(kind in result for result in found.values())]
    rows = -(-len(kinds) // _PANELS)
    columns = -(-len(kinds) // rows)
    figure = Figure(figsize=(1.2 + 3.6 * columns, 0.2 + 3.2 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for axes in panels.flat[len(kinds) :]:
        axes.remove()
    for axes, kind in zip(panels.flat, kinds, strict=False):
        for i, (label, result) in enumerate(found.items()):
            if kind not in result:
                continue
            values, shares = (np.array(result[kind][key]) for key in ("values", "survival"))
            axes.errorbar(
                values,
                100.0 * shares,
                yerr=100.0 * _bars(shares, rollouts),
                label=label,
                color=_COLOURS[i % len(_COLOURS)],
                linestyle=_LINES[i % len(_LINES)],
                marker=_MARKERS[i % len(_MARKERS)],
                markersize=5,
                capsize=3,
                elinewidth=0.8,
            )
        axes.axhline(100.0 * ENOUGH, color="grey", linewidth=0.8)
        axes.set_xlabel(KINDS[kind])
    panels[0, 0].set_ylim(-3, 103)
    for axes in panels[:, 0]:
        axes.set_ylabel(f"survive, of {rollouts} [%]")
    if len(found) > 1:
        shown = panels[0, 0].get_legend_handles_labels()
        figure.legend(*shown, frameon=False, ncols=len(_COLOURS), loc="outside upper center")
    return figure


def _bars(shares: Array, count: int) -> Array:
    """Returns how far the interval of 95 % reaches below and above each share, (2, m)."""
    low, high = np.transpose([interval(share, count) for share in shares])
    return np.maximum([shares - low, high - shares], 0.0)
