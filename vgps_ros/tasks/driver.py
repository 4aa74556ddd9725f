# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy that drives the robot of a task."""

from dataclasses import dataclass

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import Observation
from vgps_ros.core.records import Array
from vgps_ros.policies.policy_file import Policy, PolicyFile
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
