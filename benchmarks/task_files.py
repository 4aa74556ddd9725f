# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a cost by sensors costs, against the same cost written by hand with its Jacobian."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.problems import moving, with_threads
from benchmarks.timing import Comparison, compare
from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class ByHand:
    """Features whose Jacobian was written by hand.

    Attributes:
        readings: maps states (..., n_x) to r (..., m) and ∂r/∂x (..., m, n_x).
        control_dim: n_u.
    """

    readings: Callable[[Array], tuple[Array, Array]]
    control_dim: int

    def __call__(self, states: Array, controls: Array) -> Array:
        """Returns r."""
        return self.readings(states)[0]

    def linearize(self, states: Array, controls: Array) -> tuple[Array, Array, Array]:
        """Returns r and its derivatives."""
        r, j = self.readings(states)
        return r, j, np.zeros((*r.shape, self.control_dim))


def cart_pole(states: Array) -> tuple[Array, Array]:
    """Returns the pole's direction (sin θ, 0, cos θ) and the cart's place."""
    place, angle = states[..., 0], states[..., 1]
    zero, s, c = np.zeros_like(angle), np.sin(angle), np.cos(angle)
    jacobian = np.zeros((*states.shape[:-1], 4, 4))
    jacobian[..., 0, 1], jacobian[..., 2, 1], jacobian[..., 3, 0] = c, -s, 1.0
    return np.stack([s, zero, c, place], axis=-1), jacobian


def swimmer(states: Array) -> tuple[Array, Array]:
    """Returns the centre of mass's forward velocity; see tests/tasks/test_swimmer.py."""
    _, _, yaw, front, back, v_x, _, yaw_rate, front_rate, back_rate = np.moveaxis(states, -1, 0)
    a, a_rate = yaw + front, yaw_rate + front_rate
    b, b_rate = yaw + back, yaw_rate + back_rate
    velocity = v_x + (np.sin(b) * b_rate - np.sin(a) * a_rate) / 6
    by_a, by_b = -np.cos(a) * a_rate / 6, np.cos(b) * b_rate / 6
    jacobian = np.zeros((*states.shape[:-1], 1, 10))
    jacobian[..., 0, 2], jacobian[..., 0, 3], jacobian[..., 0, 4] = by_a + by_b, by_a, by_b
    jacobian[..., 0, 5] = 1.0
    jacobian[..., 0, 7] = (np.sin(b) - np.sin(a)) / 6
    jacobian[..., 0, 8], jacobian[..., 0, 9] = -np.sin(a) / 6, np.sin(b) / 6
    return velocity[..., None], jacobian


BY_HAND = {"cart_pole": cart_pole, "swimmer": swimmer}


def written_by_hand(task: Task, readings: Callable[[Array], tuple[Array, Array]]) -> Task:
    """Returns the task with the same cost, whose features are written by hand."""
    features = ByHand(readings, task.dynamics.control_dim)
    return replace(task, cost=replace(task.cost, features=features))


def task_files() -> Iterator[Comparison]:
    """An iteration of DDP with a cost by sensors, against hand-written Jacobians."""
    for name, readings in BY_HAND.items():
        task, motion = moving(name)
        single = with_threads(task, 1)
        peer = written_by_hand(single, readings)
        costs = [each.trajectory_cost(motion) for each in (single, peer)]

        def iterate(task: Task, motion: Trajectory = motion) -> None:
            solve(task.dynamics, task.cost, motion, task.optimizer.ddp, 1)

        yield compare(
            f"{name}: DDP iteration by a task file / by hand-written Jacobians",
            partial(iterate, single),
            partial(iterate, peer),
            1.1,
            repetitions=41,
            remark=f"the motion costs {costs[0]:.6f}, and {costs[1]:.6f} by hand",
        )
