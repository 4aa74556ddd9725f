"""A rotor that is turned to rest: linear dynamics, quadratic cost, two states, one torque.

    c(x, u) = w_u u² + φ² + w_ω ω²,   w_u = 1,  w_ω = 0.1 s²

It is so small that every method learns it in seconds, and that DDP finds its optimum in one
iteration. State: angle φ [rad] and its rate ω [rad/s].
"""

from pathlib import Path

import numpy as np

from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.records import Array
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.tasks.task import Task, load_model

MODEL_PATH = Path(__file__).with_suffix(".xml")
JOINTS = ("rotor",)
HORIZON = 50
RATE_WEIGHT = 0.1  # w_ω [s²]


def rotor() -> Task:
    """Returns the rotor's task."""
    dynamics = Dynamics(load_model(MODEL_PATH, JOINTS))
    return Task(
        name="rotor",
        model_path=MODEL_PATH,
        dynamics=dynamics,
        cost=FeatureCost(angle_and_rate, np.zeros(2), control_weight=1.0),
        horizon=HORIZON,
        initial_state=np.array([1.0, 0.0]),
        varied_state_std=np.array([0.5, 0.5]),
        observed=(0, 1),
        guess=lambda rng: np.zeros((HORIZON, 1)),
        initial_std=np.full(2, 0.1),
        std_limit=np.full(2, np.inf),
    )


def angle_and_rate(states: Array) -> tuple[Array, Array]:
    """Returns φ [rad] and √w_ω ω [rad], shape (..., 2), and their Jacobian (..., 2, 2)."""
    jacobian = np.diag([1.0, np.sqrt(RATE_WEIGHT)])
    return states @ jacobian, np.broadcast_to(jacobian, (*states.shape[:-1], 2, 2))
