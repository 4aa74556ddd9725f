# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The motion from which a solve starts: drawn, given, recorded, or that of the solve before."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vgps_ros.core.ddp.tracking import track
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, LinearDynamics, Trajectory
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class FirstMotion:
    """The first trajectory, what is known of it (see `solve`), and the simulator steps it took."""

    trajectory: Trajectory
    simulator_steps: int = 0
    linear_dynamics: LinearDynamics | None = None
    gaps: Array | None = None

    def under(self, dynamics: Dynamics) -> "FirstMotion":
        """Returns the motion of an undisturbed robot as one of others, which the solve mends."""
        steps = self.simulator_steps + self.trajectory.horizon * dynamics.substeps
        return FirstMotion(self.trajectory, steps, gaps=dynamics.gaps(self.trajectory))


def first_motion(
    task: Task, request: OptimizationRequest, is_cancelled: Callable[[], bool] = lambda: False
) -> FirstMotion:
    """Returns the motion from which a solve starts.

    Raises:
        InvalidInputError: neither request nor task names one.
        DivergenceError: the demonstration cannot be followed.
    """
    start, dynamics = request.initial_state, task.dynamics
    if request.previous is not None:
        previous = request.previous
        # A solve descends along the trajectory itself, of which means over q know little.
        is_mean = task.optimizer.dynamics_samples > 0
        return FirstMotion(
            previous.mean, linear_dynamics=None if is_mean else previous.linear_dynamics
        )
    if request.guess is not None and request.guess_states is not None:
        states = np.concatenate([start[None], request.guess_states[1:]])
        guessed = Trajectory(states, np.clip(request.guess, *dynamics.control_limits))
        steps = task.planned_horizon * dynamics.substeps
        return FirstMotion(guessed, steps, gaps=dynamics.gaps(guessed))
    if request.guess is not None:
        guess, horizon = request.guess, task.planned_horizon
        rollout = dynamics.rollout(start, lambda t, _: guess[t], horizon)
        return FirstMotion(rollout, horizon * dynamics.substeps)
    shown = task.demonstration
    recorded = shown is not None and np.array_equal(start, shown.states[0])
    if task.demonstrate is not None and not recorded:
        rng = generator(request.seed, Stream.INITIAL_CONTROLS, request.trajectory_index)
        motion = task.demonstrate(start, task.planned_horizon, rng, is_cancelled)
        return FirstMotion(motion)  # not counted as learning
    if shown is None:
        raise InvalidInputError("The request has neither guess nor previous; send one of them.")
    tolerance = task.optimizer.demonstration_tolerance
    followed, steps = track(dynamics, shown, start, task.position_names, tolerance)
    return FirstMotion(followed, steps)
