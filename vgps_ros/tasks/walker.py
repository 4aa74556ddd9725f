"""The paper's walker: seven links, nine degrees of freedom, 18 states, six torques.

    c(x, u) = w_u ‖u‖² + (v_x − v_x*)² + (p_y − p_y*)²,   w_u = 1e-4,  v_x* = 1 m/s,  p_y* = 0.93 m,

where v_x and p_y are the hips' horizontal velocity and height. State: root x, z [m], root pitch,
hip, knee and ankle of the left and of the right leg [rad], then their velocities.

The walker has **fallen** where its hips are below 0.65 m or its torso is pitched beyond 1 rad.
"""

from copy import copy
from functools import cache
from pathlib import Path

import numpy as np

from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import state_names
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks.conditions import Conditions
from vgps_ros.tasks.simbicon import GAIT, Simbicon, go_on, standing, walk
from vgps_ros.tasks.task import Task, load_model

MODEL_PATH = Path(__file__).with_suffix(".xml")
JOINTS = (
    *("root_x", "root_z", "root_pitch"),
    *("left_hip", "left_knee", "left_ankle"),
    *("right_hip", "right_knee", "right_ankle"),
)
HORIZON = 400
LOOKAHEAD = 60
WARM_UP = 1000  # steps after which the demonstration's gait is steady
TARGETS = np.array([1.0, 0.93])  # v_x* [m/s], p_y* [m]
CONTROL_WEIGHT = 1e-4
LOWEST_HIPS = 0.65  # [m]
LARGEST_PITCH = 1.0  # [rad]


def walker() -> Task:
    """Returns the walker's task."""
    dynamics = walker_dynamics()
    sims, names = dynamics.simulations, state_names(dynamics.model)
    first = demonstration()
    return Task(
        name="walker",
        mjcf=MODEL_PATH.read_text(),
        dynamics=dynamics,
        cost=FeatureCost(
            Readings(sims, ["root_x/velocity", "root_z/position"]),
            targets=TARGETS,
            weights=np.ones(2),
            smooth=np.zeros(2),
            control_weights=np.full(dynamics.control_dim, CONTROL_WEIGHT),
        ),
        horizon=HORIZON,
        lookahead=LOOKAHEAD,
        initial_state=first.states[0],
        varied_state_std=np.concatenate([np.zeros(3), np.full(6, 0.01), np.full(9, 0.1)]),
        # All but root x, since walking is the same everywhere.
        observation=Readings(sims, names[1:]),
        demonstration=first,
        demonstrate=demonstrate,
        fallen=fallen(dynamics),
        initial_std=np.concatenate([np.zeros(3), np.full(6, 0.01), np.full(9, 0.1)]),
        # Linearised covariances explode through contact.
        std_limit=np.concatenate(
            [[np.inf, 0.05], np.full(7, 0.3), [0.5, 0.5, 2.0], np.full(6, 4.0)]
        ),
    )


def walker_dynamics() -> Dynamics:
    """Returns the walker's dynamics, with a control every 0.01 s."""
    return Dynamics(load_model(MODEL_PATH, JOINTS), substeps=2, cyclic_joints=("root_x",))


@cache
def demonstration() -> Trajectory:
    """Returns steady walking by the SIMBICON controller, over horizon and lookahead."""
    dynamics = walker_dynamics()
    walking = walk(dynamics, GAIT, WARM_UP + HORIZON + LOOKAHEAD)
    states, controls = walking.states[WARM_UP:].copy(), walking.controls[WARM_UP:]
    states[:, 0] -= states[0, 0]
    return Trajectory(states, controls)


@cache
def _steady_controller() -> Simbicon:
    """The controller in the phase of the gait in which the demonstration begins."""
    dynamics = walker_dynamics()
    controller = Simbicon(GAIT, dynamics.time_step)
    go_on(dynamics, controller, standing(), WARM_UP)
    return controller


def demonstrate(start: Array, steps: int) -> Trajectory:
    """Returns walking by the same controller from a start near the demonstration's."""
    return go_on(walker_dynamics(), copy(_steady_controller()), start, steps)


def fallen(dynamics: Dynamics) -> Conditions:
    """Returns what tells whether the walker has fallen."""
    return Conditions(
        Readings(dynamics.simulations, ["root_z/position", "root_pitch/position"]),
        lowest=np.array([LOWEST_HIPS, -LARGEST_PITCH]),
        highest=np.array([np.inf, LARGEST_PITCH]),
    )
