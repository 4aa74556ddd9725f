# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy that drives the robot of a task."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from vgps_ros.core.checks import quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.executed_control import Policy as AnyPolicy
from vgps_ros.core.executed_control import RememberingPolicy
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.policies.contract import BASE, TOLD, nearest_term
from vgps_ros.policies.onnx_policy import OnnxPolicy
from vgps_ros.policies.policy_file import PolicyFile
from vgps_ros.simulation.controls import closed_loops
from vgps_ros.simulation.dynamics import Dynamics, Simulations
from vgps_ros.simulation.model import compile_model
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks.disturbed_task import on_dynamics
from vgps_ros.tasks.signals import Signals
from vgps_ros.tasks.task import Task

_SAME_PERIOD = 1e-3  # relative difference of two periods that are the same but for their text


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

    policy: GaussianPolicy | RememberingPolicy | OnnxPolicy
    observation: Observation

    @classmethod
    def of(cls, task: Task, policy: GaussianPolicy) -> "Driver":
        """Returns a policy that was learned for the task."""
        if past := task.observation.past:
            return cls(RememberingPolicy(policy, past), task.observation.now)
        return cls(policy, task.observation)

    def started(self) -> Callable[..., Array]:
        """Returns the law of a run of N robots, which remembers what its policy does.

        It is called step after step with o (N, n_o), and perhaps with noise (N, n_u).
        """
        policy, memory = self.policy, None
        answer = getattr(policy, "answer", None)  # of one that may remember

        def law(inputs: Array, noise: Array | float = 0.0) -> Array:
            nonlocal memory
            if answer is None:
                return policy.mean(inputs) + noise
            controls, memory = answer(inputs, memory, noise)
            return np.asarray(controls)

        return law

    def mean(self, states: Array) -> Array:
        """Returns the controls without noise in states (..., n_x), shape (..., n_u), [N·m].

        Where the policy is told something, the states are those of the steps of the observation's
        context, or the observation must be `within` that of a single step.
        """
        return self.policy.mean(self.observation(states))


def observation_of(
    policy: AnyPolicy, simulations: Simulations, signals: Signals, name: str
) -> Observation:
    """Returns what a policy reads of a robot's states and of what it is told.

    Args:
        policy: the policy.
        simulations: of the robot.
        signals: the commands and the clock of its task.
        name: what the sentence of an error calls the policy.

    Raises:
        InvalidInputError: the robot lacks it, or nobody tells it.
    """
    model = simulations.model
    free = [i for i in range(model.njnt) if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE][:1]
    known = {command.source: f"command/{command.name}" for command in signals.commands}
    base = model.joint(free[0]).name if free else BASE
    names = [known.get(each, each).replace(BASE, base) for each in policy.observed]
    told = [each for each in names if each in signals.names]
    if strange := [each for each in names if each.startswith(TOLD) and each not in told]:
        raise InvalidInputError(
            f"{name} reads {quoted(strange[0])}, but the task tells "
            f"{', '.join([*signals.names, *known]) or 'nothing'}; add it to the task's commands, "
            "or a clock."
        )
    try:
        readings = Readings(simulations, [each for each in names if each not in told])
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


def driver_of(task: Task, file: PolicyFile) -> Driver:
    """Returns the policy of a file as one that drives the task's robot.

    Raises:
        InvalidInputError: the policy does not fit the robot.
    """
    if file.gaussian:
        file.gaussian.check_fits(task.observation.names, task.dynamics.control_dim)
        return Driver.of(task, file.gaussian)
    policy = file.policy(task.controls)
    observation = observation_of(policy, task.dynamics.simulations, task.signals, file.name)
    assert isinstance(policy, OnnxPolicy)
    periods = (policy.contract.period, task.dynamics.time_step, "control_period", "control period")
    clocks = (policy.contract.gait_period, task.signals.period, "gait_period", "turn of the clock")
    for wanted, own, key, what in (periods, clocks):
        if wanted and not abs(wanted - own) <= _SAME_PERIOD * wanted:
            raise InvalidInputError(
                f"{file.name} has a {key} of {wanted:g} s, but the {what} of {task.name} takes "
                f"{own:g} s; change it in the task file."
            )
    if observation.readings.needs_controls:  # type: ignore[attr-defined]
        raise InvalidInputError(
            f"{file.name} reads a sensor of forces or accelerations, which depends on the control "
            "that it has yet to choose; use a policy that reads positions and velocities."
        )
    return Driver(policy, observation.within(task.planned_context))
