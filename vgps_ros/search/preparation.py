# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compiles the loops that a search needs, so that no request waits for the compiler."""

import numpy as np

from vgps_ros.core.ddp.backward_pass import backward_pass
from vgps_ros.core.executed_control import ExecutedPolicy
from vgps_ros.core.notice import notice
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.tasks import Task


def prepare(task: Task) -> None:
    """Runs each compiled loop once, for one step; it takes seconds only on a new machine."""
    with notice("Compiling for this machine, which takes some ten seconds and is kept ..."):
        _run_each_loop(task)


def _run_each_loop(task: Task) -> None:
    dynamics = task.dynamics
    motion = dynamics.rollout(task.initial_state, lambda *_: np.zeros(dynamics.control_dim), 1)
    local = backward_pass(dynamics.linearize(motion)[0], task.cost.expand(motion), 1.0)
    list(dynamics.follow_each(task.initial_state, [motion], local.gains))
    shape = Architecture(task.observation.names, (1,), dynamics.control_dim)
    policy = GaussianPolicy(shape, np.zeros(shape.num_parameters), np.ones(dynamics.control_dim))
    ExecutedPolicy(policy)
    noise = np.zeros((1, 1, dynamics.control_dim))
    dynamics.execute(policy, task.observation, motion.states[:1], noise)
    dynamics.replay(task.initial_state, motion.controls[None])
    task.observation.linearize(motion.states[:1])
    for read in (task.observation, task.fallen):
        read(motion.states)
    task.cost.values(motion)
