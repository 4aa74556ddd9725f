# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Figure 1 of the paper as a Rerun recording, where one can zoom in and hide methods."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib.colors import to_rgb

from vgps_ros.core.records import Array
from vgps_ros.simulation.model import compile_model
from vgps_ros.views.comparison import ComparisonPanel, styles
from vgps_ros.views.recording import Recording
from vgps_ros.views.robot_shape import RobotShape
from vgps_ros.views.rows import ITERATION
from vgps_ros.views.run_record import RunRecord

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
