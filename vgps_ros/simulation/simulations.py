# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Simulations of one MuJoCo model, one for each thread, and the threads that share work on them."""

import os
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from functools import partial
from queue import SimpleQueue
from typing import Any, TypeVar

import mujoco
import numpy as np

from vgps_ros.simulation.compiled_states import NO_PUSH, BodyPush, CompiledSimulation, simulation_of
from vgps_ros.simulation.model import check_supported, state_space
from vgps_ros.simulation.warnings import warnings_of

# Parts of the work for each thread: a thread whose core others use too then does fewer of them.
_PARTS = 4

T = TypeVar("T")

_others_use_the_cores = False


def use_one_thread() -> None:
    """Lets simulations of this process use one thread each, since others use the other cores."""
    global _others_use_the_cores  # noqa: PLW0603
    _others_use_the_cores = True


class Simulations:
    """A model with as many simulations of it as there are threads.

    Attributes:
        model: a copy of the model in which MuJoCo does not reset a state that it finds bad; here
            such a state counts as diverged.
        space: space of its states.
        threads: threads that share the work; their number changes no result.

    Args:
        model: the robot.
        substeps: simulator steps for which one control is held.
        threads: number of threads; None for as many as there are processors.
        push: a push of the robot, which belongs to its dynamics.

    Raises:
        InvalidInputError: a state of the model is more than (qpos, qvel, act).
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        substeps: int = 1,
        threads: int | None = None,
        push: BodyPush = NO_PUSH,
    ):
        check_supported(model)
        self.model = model = copy(model)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.space = state_space(model)
        self.substeps = substeps
        cores = 1 if _others_use_the_cores else len(os.sched_getaffinity(0))
        self.threads = threads or cores
        self._data = [mujoco.MjData(model) for _ in range(self.threads)]
        self._idle = SimpleQueue[CompiledSimulation]()  # those that no thread is using
        for data in self._data:
            self._idle.put(simulation_of(model, data, substeps, push))
        self._pool = ThreadPoolExecutor(self.threads)  # it starts no thread before the first work

    def warnings(self) -> Counter[str]:
        """Returns how often MuJoCo has warned in these simulations so far, by kind."""
        return warnings_of(self._data)

    def in_threads(self, count: int, work: Callable[[CompiledSimulation, slice], T]) -> list[T]:
        """Divides `count` pieces of work into parts; each thread takes the next part."""
        if min(self.threads, count) == 1:
            return [self.in_one(work, slice(0, count))]
        ends = np.linspace(0, count, min(count, _PARTS * self.threads) + 1).astype(int)
        parts = map(slice, ends[:-1], ends[1:])
        return list(self._pool.map(partial(self.in_one, work), parts))

    def in_one(self, work: Callable[..., T], *arguments: Any) -> T:
        """Does a piece of work in this thread."""
        simulation = self._idle.get()
        try:
            return work(simulation, *arguments)
        finally:
            self._idle.put(simulation)
