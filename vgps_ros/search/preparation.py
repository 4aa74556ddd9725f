"""Compiles what a search needs, so that no request has to wait for it."""

import numpy as np

from vgps_ros.core.ddp import backward_pass
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.tasks import Task


def prepare(task: Task) -> None:
    """Runs each compiled loop once, over one step: seconds on a new machine, later a moment."""
    dynamics = task.dynamics
    motion = dynamics.rollout(task.initial_state, lambda *_: np.zeros(dynamics.control_dim), 1)
    local = backward_pass(dynamics.linearize(motion), task.cost.expand(motion), 1.0)
    dynamics.follow(task.initial_state, motion, local.gains)
    shape = Architecture(task.observed, (1,), dynamics.control_dim)
    policy = GaussianPolicy(shape, np.zeros(shape.num_parameters), np.ones(dynamics.control_dim))
    dynamics.execute(policy, motion.states[:1], np.zeros((1, 1, dynamics.control_dim)))
    dynamics.simulator_steps = 0
