"""Compiles the loops that a search needs, so that no request waits for the compiler."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from vgps_ros.core.ddp.backward_pass import backward_pass
from vgps_ros.core.executed_control import ExecutedPolicy
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.tasks import Task

_NOTICE_DELAY = 2.0  # time after which the notice is printed [s]


def prepare(task: Task) -> None:
    """Runs each compiled loop once, for one step; it takes seconds only on a new machine."""
    with _notice("Compiling for this machine, which takes some ten seconds and is kept ..."):
        _run_each_loop(task)


@contextmanager
def _notice(sentence: str) -> Iterator[None]:
    """Prints a sentence if the block that follows is not done soon."""
    timer = threading.Timer(_NOTICE_DELAY, print, (sentence,), {"flush": True})
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


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
    task.observation.linearize(motion.states[:1])
    for read in (task.observation, task.fallen):
        read(motion.states)
    task.cost.values(motion)
