"""How a recording opens in the Rerun viewer, and where in it things are."""

import rerun as rr
import rerun.blueprint as rrb

POSITION = "/joint_states/position"
VELOCITY = "/joint_states/velocity"
EFFORT = "/joint_states/effort"
COMMAND = "/joint_command/effort"
COSTS = "/learning_progress/cost"
ALPHA = "/learning_progress/alpha"
NOISE = "/policy/noise_std"
CENTRE_OF_MASS = "/centre_of_mass"
DISTRIBUTION = "/trajectory_distribution"
INITIAL_DDP = "/initial_ddp"

# Stamps and receive times are called as Rerun's own reader of MCAP bags calls them.
STAMP = "ros2_timestamp"
RECEIVED = "message_log_time"
ITERATION = "iteration"


def blueprint() -> rrb.Blueprint:
    """Returns the layout: the robot above, what it does below, what it learns at the right."""
    scene = rrb.Spatial3DView(
        name="Robot, its path, and the path of the initial DDP solution",
        contents=["/robot/**", f"{CENTRE_OF_MASS}/**", f"{INITIAL_DDP}/**", f"{DISTRIBUTION}/**"],
        eye_controls=rrb.EyeControls3D(
            position=(5.0, -8.0, 7.0), look_target=(5.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)
        ),
    )
    motion = rrb.Tabs(
        _plot("Joint angles [rad] and the distribution's ±2 sd", POSITION, f"{DISTRIBUTION}/**"),
        _plot("Joint velocities [m/s, rad/s]", VELOCITY),
        _plot("Torques commanded [N·m]", COMMAND, EFFORT),
    )
    learning = rrb.Vertical(
        _plot("Cost", COSTS),
        rrb.Tabs(
            _plot("Cost's scale α", ALPHA),
            _plot("Policy noise [N·m]", NOISE),
            # The optimizers' names are their users' choice; their topics all end alike.
            _plot("Modified cost, each DDP iteration", "+ /**", "- /robot/**", *_NOT_SOLVER),
        ),
    )
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(scene, motion), learning, column_shares=[3, 2]),
        rrb.TimePanel(timeline=STAMP),
        collapse_panels=True,
    )


_NOT_SOLVER = tuple(
    f"- /{path.split('/')[1]}/**"
    for path in (POSITION, COMMAND, COSTS, NOISE, CENTRE_OF_MASS, DISTRIBUTION, INITIAL_DDP)
)


def _plot(name: str, *contents: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        name=name, contents=list(contents), plot_legend=rrb.PlotLegend(rr.components.Corner2D.RightTop)
    )
