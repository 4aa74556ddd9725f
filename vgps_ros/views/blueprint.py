# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The layout in which the Rerun viewer shows a recording of a run."""

from collections.abc import Sequence

import mujoco
import numpy as np
import rerun.blueprint as rrb

from vgps_ros.views.recording import TIME
from vgps_ros.views.robot_shape import RobotShape

_FROM_SIDE, _FROM_ABOVE = (-0.6, -2.4, 0.7), (0.0, -0.3, 2.5)  # in sizes of the robot
_COSTS = ("stochastic_cost", "deterministic_cost", "ddp_cost", "initial_ddp_cost")


def eye(model: mujoco.MjModel, shape: RobotShape) -> rrb.EyeControls3D:
    """Returns an eye that sees the whole robot in the plane it moves in, and goes with it."""
    target = shape.centre_of_mass(model.qpos0)
    away = _FROM_ABOVE if shape.plane == (0, 1) else _FROM_SIDE
    return rrb.EyeControls3D(
        position=target + model.stat.extent * np.array(away),
        look_target=target,
        tracking_entity=f"world/robot/{shape.names[0]}" if shape.names else None,
    )


def blueprint(
    hinge_names: Sequence[str], eye: rrb.EyeControls3D, *, has_base: bool = False
) -> rrb.Blueprint:
    """Returns the layout for a robot with the named hinges, its turning joints.

    Args:
        hinge_names: names of the hinges.
        eye: from where the robot is seen.
        has_base: whether the robot has a free base, whose position is then shown too.
    """
    whole_run = rrb.VisibleTimeRanges(
        rrb.VisibleTimeRange(
            TIME,
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    )
    tubes = [
        rrb.TimeSeriesView(origin=f"trajectory_distribution/{name}", name=f"{name} [rad]")
        for name in hinge_names
    ]
    left = rrb.Vertical(
        rrb.Spatial3DView(
            origin="world",
            name="robot; centre of mass: learned (blue), initial DDP (black), plan (green)",
            overrides={"world/centre_of_mass": [whole_run]},
            eye_controls=eye,
        ),
        rrb.TimeSeriesView(contents=[f"learning/{c}" for c in _COSTS], name="cost by iteration"),
        rrb.Tabs(
            rrb.TimeSeriesView(contents=["learning/alpha"], name="alpha by iteration"),
            rrb.TimeSeriesView(contents=["learning/policy_kl"], name="KL(q, policy) [nat]"),
            rrb.TimeSeriesView(contents=["learning/bound"], name="bound L(q, theta) [nat]"),
            rrb.TimeSeriesView(contents=["learning/coverage"], name="rollouts within q ± 2 sd"),
            rrb.TimeSeriesView(origin="policy/noise_std", name="policy noise [N·m]"),
            rrb.TimeSeriesView(origin="solves", name="modified cost of the DDP solves"),
            rrb.TimeSeriesView(origin="plan", name="plans: cost, solve time [s]"),
        ),
        row_shares=[4, 2, 1],
    )
    base = [rrb.TimeSeriesView(origin="odom/position", name="base [m]")] if has_base else []
    right = rrb.Vertical(
        rrb.Tabs(*tubes, name="executed within q ± 2 sd") if tubes else rrb.TextDocumentView(),
        *base,
        rrb.TimeSeriesView(origin="joint_states/position", name="position [m, rad]"),
        rrb.TimeSeriesView(origin="joint_states/velocity", name="velocity [m/s, rad/s]"),
        rrb.TimeSeriesView(origin="joint_command/effort", name="torque [N·m]"),
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right), rrb.TimePanel(timeline=TIME), collapse_panels=True
    )
