"""A rotor that is turned to rest: linear dynamics, quadratic cost, two states, one torque.

    c(x, u) = w_u u² + φ² + w_ω ω²,   w_u = 1,  w_ω = 0.1 s²

It is so small that every method learns it in seconds, and that DDP finds its optimum in one
iteration. State: angle φ [rad] and its rate ω [rad/s].
"""

from pathlib import Path

import numpy as np

from vgps_ros.core.cost import FeatureCost
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks.conditions import Conditions
from vgps_ros.tasks.task import Task, load_model

MODEL_PATH = Path(__file__).with_suffix(".xml")
JOINTS = ("rotor",)
HORIZON = 50
RATE_WEIGHT = 0.1  # w_ω [s²]


def rotor() -> Task:
    """Returns the rotor's task."""
    dynamics = Dynamics(load_model(MODEL_PATH, JOINTS))
    readings = Readings(dynamics.simulations, ["rotor/position", "rotor/velocity"])
    return Task(
        name="rotor",
        mjcf=MODEL_PATH.read_text(),
        dynamics=dynamics,
        cost=FeatureCost(
            readings,
            targets=np.zeros(2),
            weights=np.array([1.0, RATE_WEIGHT]),
            smooth=np.zeros(2),
            control_weights=np.ones(1),
        ),
        horizon=HORIZON,
        initial_state=np.array([1.0, 0.0]),
        varied_state_std=np.array([0.5, 0.5]),
        observation=readings,
        fallen=Conditions(Readings(dynamics.simulations, []), np.empty(0), np.empty(0)),
        guess=lambda rng: np.zeros((HORIZON, 1)),
        initial_std=np.full(2, 0.1),
        std_limit=np.full(2, np.inf),
    )
