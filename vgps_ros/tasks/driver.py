# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy that drives the robot of a task."""

from dataclasses import dataclass, replace

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.policies.policy_file import Policy, PolicyFile
from vgps_ros.simulation.controls import closed_loops
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import compile_model
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks.disturbed_task import on_dynamics
from vgps_ros.tasks.task import Task


def in_closed_loops(task: Task, stiffness: Array, damping: Array) -> Task:
    """Returns the task with servos in place of motors; see `simulation.controls.closed_loops`.

    No cost of the task scores their controls, which are targets of positions.

    Raises:
        InvalidInputError: a gain does not suit its actuator.
    """
    mjcf = closed_loops(task.mjcf, stiffness, damping)
    if mjcf == task.mjcf:
        return task
    cost = replace(task.cost, control_weights=np.zeros_like(stiffness))
    dynamics = Dynamics(compile_model(mjcf), task.dynamics.substeps)
    return on_dynamics(replace(task, mjcf=mjcf, cost=cost), dynamics)


def for_policy(task: Task, file: PolicyFile) -> Task:
    """Returns the task in whose robot the loops of a network's gains are closed.

    Raises:
        InvalidInputError: the network does not fit the robot.
    """
    policy = file.policy(task.controls)
    if isinstance(policy, GaussianPolicy) or not policy.stiffness.any():
        return task
    return in_closed_loops(task, policy.stiffness, policy.damping)


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
    policy = file.policy(task.controls)
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
