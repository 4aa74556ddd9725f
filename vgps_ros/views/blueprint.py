# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The layout in which the Rerun viewer shows a recording of a run."""

from collections.abc import Collection, Sequence
from typing import Any

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vgps_ros.messages.names import CONTEXT
from vgps_ros.robot.controls import Controls
from vgps_ros.views.recording import TIME
from vgps_ros.views.robot_shape import RobotShape, floor

_DEPTH = 0.1  # of the ground below a robot that moves in a horizontal plane, in its sizes
LEARNING_CURVE = "learning_curve"  # entity of the picture
PLAN_COST, PLAN_TIME = "plan/cost", "plan/solve_time"
_COSTS = ("stochastic_cost", "deterministic_cost", "ddp_cost", "initial_ddp_cost")


def eye(model: mujoco.MjModel, shape: RobotShape) -> rrb.EyeControls3D:
    """Returns an eye that sees the whole robot in the plane it moves in, and goes with it."""
    target = shape.centre_of_mass(model.qpos0)
    return rrb.EyeControls3D(
        position=target + shape.viewpoint,
        look_target=target,
        tracking_entity=f"world/robot/{shape.names[0]}" if shape.names else None,
    )


def ground(model: mujoco.MjModel, shape: RobotShape) -> rrb.LineGrid3D:
    """Returns the lines that stand for the floor, past which the robot is seen to move.

    Without a floor they are at height zero, or below a robot that moves in a horizontal plane.
    """
    normal, distance = np.array([0.0, 0.0, 1.0]), 0.0
    if (i := floor(model)) is not None:
        shape.centre_of_mass(model.qpos0)  # which places the floor, too
        normal = shape.data.geom_xmat[i].reshape(3, 3)[:, 2]
        distance = normal @ shape.data.geom_xpos[i]
    elif shape.plane == (0, 1):
        distance = -_DEPTH * model.stat.extent
    return rrb.LineGrid3D(
        visible=True,
        spacing=max(0.1, round(0.25 * model.stat.extent, 1)),
        plane=rr.components.Plane3D(normal, distance),
        color=(90, 96, 100),
        stroke_width=1.0,
    )


def blueprint(
    hinge_names: Sequence[str],
    controls: Controls,
    eye: rrb.EyeControls3D,
    ground: rrb.LineGrid3D,
    *,
    has_base: bool = False,
    logged: Collection[str] | None = None,
) -> rrb.Blueprint:
    """Returns the layout for a robot with the named hinges, its turning joints.

    Args:
        hinge_names: names of the hinges.
        controls: what the robot's controls are.
        eye: from where the robot is seen.
        ground: lines on the ground.
        has_base: whether the robot has a free base, whose position is then shown too.
        logged: entities that a complete recording holds; views of others are left out. None for a
            recording that is still being written, which may hold all of them one day.
    """
    whole_run = rrb.VisibleTimeRanges(
        rrb.VisibleTimeRange(
            TIME,
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    )
    robot = rrb.Spatial3DView(
        origin="world",
        name="robot; centre of mass: learned (blue), initial DDP (black), plan (green)",
        overrides={"world/centre_of_mass": [whole_run]},
        eye_controls=eye,
        line_grid=ground,
    )
    below: list[rrb.View] = []
    if logged is None or LEARNING_CURVE in logged:
        # All but the first are blank until the reader chooses the timeline of iterations.
        below += [
            rrb.Spatial2DView(origin=LEARNING_CURVE, name="learning curve"),
            _series("cost by iteration", contents=[f"learning/{c}" for c in _COSTS]),
            _series("alpha", contents=["learning/alpha"]),
            _series("KL(q, policy) [nat]", contents=["learning/policy_kl"]),
            _series("bound L(q, theta) [nat]", contents=["learning/bound"]),
            _series("rollouts within q ± 2 sd", contents=["learning/coverage"]),
            _series(f"policy noise: {controls.label()}", origin="policy/noise_std"),
            _series("modified cost of the DDP solves", origin="solves"),
        ]
    if logged is None or PLAN_COST in logged:
        below += [
            _series("cost of the plans", contents=[PLAN_COST], legend=False),
            _series("solve time of the plans [s]", contents=[PLAN_TIME], legend=False),
        ]
    context = [("commands", f"{CONTEXT}/command"), ("clock", f"{CONTEXT}/clock")]
    shown = [(name, entity) for name, entity in context if logged and entity in logged]
    below = [*(_series(name, origin=entity) for name, entity in shown), *below]
    tabs = [rrb.Tabs(*below)] if below else []
    left = rrb.Vertical(robot, *tabs, row_shares=[1] * (1 + len(tabs)))
    tubes = [
        _series(f"{name} [rad]: executed (blue) within q ± 2 sd (orange)",
                origin=f"trajectory_distribution/{name}", legend=False)
        for name in hinge_names
    ]  # fmt: skip
    axes = "base [m]: x (red), y (green), z (blue)"
    base = [_series(axes, origin="odom/position", legend=False)] if has_base else []
    right = rrb.Vertical(
        rrb.Tabs(*tubes, name="executed within q ± 2 sd") if tubes else rrb.TextDocumentView(),
        *base,
        _series("position [m, rad]", origin="joint_states/position", legend=False),
        _series("velocity [m/s, rad/s]", origin="joint_states/velocity", legend=False),
        *(
            _series(controls.label(mask), origin=f"joint_command/{field}", legend=False)
            for field, mask in controls.fields.items()
        ),
    )
    panel = rrb.TimePanel(state="collapsed", timeline=TIME, play_state="playing", loop_mode="all")
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]), panel, collapse_panels=True
    )


def _series(name: str, *, legend: bool = True, **shown: Any) -> rrb.TimeSeriesView:
    """Returns a view of numbers over time; a legend stands where curves have begun long ago."""
    corner = rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend)
    return rrb.TimeSeriesView(name=name, plot_legend=corner, **shown)
