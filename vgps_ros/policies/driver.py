# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Makes the policy of a file drive the robot of a task."""

from math import isclose
from typing import TYPE_CHECKING

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.policies.contract import BASE, CONTEXTS, Contract, nearest_term
from vgps_ros.policies.onnx_policy import OnnxPolicy
from vgps_ros.policies.policy_file import PolicyFile
from vgps_ros.robot.bodies import StateLayout
from vgps_ros.robot.deployment import Deployment, Reader
from vgps_ros.robot.executed_control import Driver
from vgps_ros.robot.executed_control import Policy as AnyPolicy
from vgps_ros.robot.signals import Signals

if TYPE_CHECKING:
    from vgps_ros.tasks.task import Task

SAME_PERIOD = 1e-3  # relative difference of two periods that are the same but for their text


def observation_of(
    policy: AnyPolicy | Contract, layout: StateLayout, read: Reader, signals: Signals, name: str
) -> Observation:
    """Returns what a policy reads of a robot's states and of what it is told.

    Args:
        policy: the policy, or its contract.
        layout: what the numbers of the robot's state are.
        read: returns its readings by their names.
        signals: the commands and the clock of its task.
        name: what the sentence of an error calls the policy.

    Raises:
        InvalidInputError: the robot lacks it, or nobody tells it.
    """
    base = layout.names[layout.base.first_position].rpartition("/")[0] if layout.base else BASE
    known = {command.source: f"command/{command.name}" for command in signals.commands}
    names = [known.get(each, each).replace(BASE, base) for each in policy.observed]
    told = [each for each in names if each in signals.names]
    if strange := [each for each in names if each.startswith(CONTEXTS) and each not in told]:
        raise InvalidInputError(
            f"{name} reads {quote(strange[0])}, but the task tells "
            f"{', '.join([*signals.names, *known]) or 'nothing'}; add it to the task's commands, "
            "or a clock."
        )
    try:
        readings = read([each for each in names if each not in told])
    except InvalidInputError as error:
        strange = [each for each in names if f"'{each}'" in str(error)]
        raise InvalidInputError(f"Of {name}: {error}{nearest_term(*strange[:1])}") from error
    observation = Observation.of(readings, told, signals.names)
    if list(observation.names) != names:
        raise InvalidInputError(
            f"{name} reads {', '.join(told)} before other numbers, but commands and clock must "
            "come last; export it with them at the end."
        )
    return observation


def driver_of(deployment: Deployment, file: PolicyFile) -> Driver:
    """Returns the policy of a file as one that drives the robot.

    Raises:
        InvalidInputError: the policy does not fit the robot.
    """
    observation, controls = deployment.observation, deployment.controls
    if file.gaussian:
        file.gaussian.check_fits(observation.names, len(controls.names))
        return Driver.of(observation, file.gaussian)
    policy, signals = file.policy(controls), deployment.signals
    layout, read = deployment.layout, deployment.read
    observation = observation_of(policy, layout, read, signals, file.name)
    assert isinstance(policy, OnnxPolicy)
    periods = (policy.contract.period, deployment.time_step, "control_period", "control period")
    clocks = (policy.contract.gait_period, signals.period, "gait_period", "turn of the clock")
    for wanted, own, key, what in (periods, clocks):
        if wanted and not isclose(wanted, own, rel_tol=SAME_PERIOD):
            raise InvalidInputError(
                f"{file.name} has a {key} of {wanted:g} s, but the {what} of {deployment.name} "
                f"takes {own:g} s; `vgps import` writes the task with the policy's."
            )
    if observation.readings.needs_controls:  # type: ignore[attr-defined]
        raise InvalidInputError(
            f"{file.name} reads a sensor of forces or accelerations, which depends on the control "
            "that it has yet to choose; use a policy that reads positions and velocities."
        )
    return Driver(policy, observation)


def for_policy(task: "Task", file: PolicyFile) -> "Task":
    """Returns the task in whose robot the loops of a network's gains are closed.

    Raises:
        InvalidInputError: the network does not fit the robot.
    """
    from vgps_ros.tasks.disturbed_task import with_servos

    policy = file.policy(task.controls)
    if isinstance(policy, GaussianPolicy) or not policy.stiffness.any():
        return task
    return with_servos(task, policy.stiffness, policy.damping)
