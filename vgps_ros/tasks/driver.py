# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy that drives the robot of a task, and the motion that it makes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import Observation
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.policies.policy_file import Policy, PolicyFile, open_policy
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks.task import Task


@dataclass(frozen=True)
class Driver:
    """A policy and what it reads of a state.

    Attributes:
        policy: the policy.
        observation: what it reads; of a network of others it may be more than the task's policies
            read.
    """

    policy: Policy
    observation: Observation

    def mean(self, states: Array) -> Array:
        """Returns the controls without noise in states (..., n_x), shape (..., n_u), [N·m].

        Where the policy is told something, the states are those of the steps of the observation's
        context, or the observation must be `within` that of a single step.
        """
        return self.policy.mean(self.observation(states))


def driver_of(task: Task, file: PolicyFile) -> Driver:
    """Returns the policy of a file as one that drives the task's robot.

    Raises:
        InvalidInputError: the policy does not fit the robot.
    """
    policy = file.policy(task.actuated_joint_names)
    if file.gaussian:
        file.gaussian.check_fits(task.observation.names, task.dynamics.control_dim)
        return Driver(policy, task.observation)
    signals = task.signals.names
    told = [name for name in policy.observed if name in signals]
    readings = Readings(
        task.dynamics.simulations, [name for name in policy.observed if name not in told]
    )
    observation = Observation.of(readings, told, signals).within(task.planned_context)
    if observation.names != tuple(policy.observed):
        raise InvalidInputError(
            f"{file.name} reads {', '.join(told)} before other numbers, but commands and clock "
            "must come last; export it with them at the end."
        )
    if readings.needs_controls:
        raise InvalidInputError(
            f"{file.name} reads a sensor of forces or accelerations, which depends on the control "
            "that it has yet to choose; use a policy that reads positions and velocities."
        )
    return Driver(policy, observation)


def demonstrated_by(task: Task, path: Path) -> Task:
    """Returns the task with the motion of a policy, without its noise, as its demonstration.

    Raises:
        InvalidInputError: the file is no policy for the robot, or the motion diverges.
    """
    driver = driver_of(task, open_policy(path))

    def demonstrate(
        start: Array,
        steps: int,
        _rng: np.random.Generator,
        _is_cancelled: Callable[[], bool] = lambda: False,
        /,
    ) -> Trajectory:
        context = task.planned_context

        def law(t: int, x: Array) -> Array:
            told = driver.observation.within(context[min(t, len(context) - 1)])
            return driver.policy.mean(told(x))

        return task.dynamics.rollout(start, law, steps)

    shown = demonstrate(task.initial_state, task.planned_horizon, np.random.default_rng(0))
    sound = np.isfinite(shown.states).all(axis=1)
    if not sound.all():
        seconds = sound.argmin() * task.dynamics.time_step
        raise InvalidInputError(
            f"The motion of '{path}' diverges after {seconds:.2f} s, so no training can start from "
            "it; check the metadata's joint_names, observation_names and action_scale."
        )
    return replace(task, demonstration=shown, demonstrate=demonstrate, guess=None, path=None)
