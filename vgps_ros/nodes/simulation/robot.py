# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The robot that the node `simulation` holds: its state, its time, its limits."""

from functools import cached_property

import mujoco
import numpy as np

from vgps_ros.core.dynamics import DIVERGENCE_BOUND
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import stamp_of
from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.simulation.forces import BodyFrames, JointForces
from vgps_ros.simulation.model import state_names
from vgps_ros.tasks import Task


class SimulatedRobot:
    """A task's dynamics with a state and a clock.

    Attributes:
        messages: the messages of the state by topic, with the efforts that led to it.
        stamp: simulated time [ns]; from a count of steps, so that it does not drift.
        control: the controls that led to the state, shape (n_u,); those at rest after a reset.
        previous_stamp: time of the state before this one [ns].
    """

    def __init__(self, task: Task, states: StateMessages, state: Array):
        self._task, self._states = task, states
        self._forces = JointForces(task.dynamics.model)
        self._bodies = BodyFrames(task.dynamics.model)
        self._push: tuple[int, Array, Array] | None = None
        self._pushed_steps = 0  # for which the push still acts
        self._steps = 0
        self.previous_stamp = -1
        self._at_rest = np.zeros(len(states.joint_names))
        self._enter(state, self._at_rest)
        self.control = self.resting()

    @cached_property
    def state(self) -> Array:
        """The state as the messages say it, shape (n_x,); the next step starts from it."""
        return self._states.join(self.messages)

    def check(self, command: Array) -> None:
        """Checks controls that come from outside.

        Raises:
            InvalidInputError: one is so large that MuJoCo would put zero in its place.
        """
        too_large = np.abs(command) >= mujoco.mjMAXVAL
        if too_large.any():
            first, controls = int(np.argmax(too_large)), self._task.controls
            raise InvalidInputError(
                f"joint_command.{controls.kinds[first].field} is "
                f"{controls.at_joints(command)[first]:g} for {controls.names[first]}, which makes "
                f"a control of {command[first]:g}, but that must be below {mujoco.mjMAXVAL:g}."
            )

    def advance(self, command: Array) -> None:
        """Holds controls, shape (n_u,), for one control step.

        Raises:
            DivergenceError: the next state is out of bounds; the robot keeps the one it has.
        """
        applied = None
        if self._push and self._pushed_steps:
            applied = self._bodies.applied(self.state, *self._push)
        state = self._task.dynamics.step(self.state, command, applied)
        # A NaN fails the comparison too.
        inside = np.abs(state) < DIVERGENCE_BOUND
        if not inside.all():
            first = int(np.argmin(inside))
            raise DivergenceError(
                f"The state diverged at {self.stamp * 1e-9:g} s: "
                f"{state_names(self._task.dynamics.model)[first]} became {state[first]:g}. The "
                "simulation is paused; reset it, and check the policy and the initial state."
            )
        self.previous_stamp = self.stamp
        efforts = self._forces(self.state, command)
        self.control = command
        self._steps += 1
        self._pushed_steps -= applied is not None
        self._enter(state, efforts)

    def push(self, body: str, wrench: Array, duration: float) -> None:
        """Lets a force and a torque act on a body from the next step on, in place of the last.

        Args:
            body: its name in the MJCF.
            wrench: force at its origin and torque, along its axes, shape (6,) [N, N·m].
            duration: simulated time for which they act, at least one step [s].

        Raises:
            InvalidInputError: there is no such body, or MuJoCo would put zero in a value's place.
        """
        if (np.abs(wrench) >= mujoco.mjMAXVAL).any():
            raise InvalidInputError(
                f"wrench has {np.abs(wrench).max():g}; every value must be below "
                f"{mujoco.mjMAXVAL:g}."
            )
        self._push = self._bodies.body(body), wrench[:3], wrench[3:]
        self._pushed_steps = max(1, round(duration / self._task.dynamics.time_step))

    def reset(self, state: Array | None, *, time: bool) -> None:
        """Puts the robot into a state, where one is given, and its time to 0, where asked."""
        self.previous_stamp = self.stamp
        self._pushed_steps = 0
        if time:
            self._steps = 0
        if state is None:
            self._enter(self.state, self._efforts)
        else:
            self._enter(state, self._at_rest)
            self.control = self.resting()

    def close_loops(self, task: Task) -> None:
        """Goes on as the robot of a task with other actuators, in the same state."""
        self._task, self._forces = task, JointForces(task.dynamics.model)
        self.control = self.resting()

    def resting(self) -> Array:
        """Returns the controls that leave the robot alone in its state, shape (n_u,)."""
        return self._task.controls.resting(self.state)

    def _enter(self, state: Array, efforts: Array) -> None:
        self._efforts = efforts
        self.__dict__.pop("state", None)  # joined from these messages once it is needed
        self.stamp = round(self._steps * self._task.dynamics.time_step * 1e9)
        self.messages = self._states.split(state, stamp_of(self.stamp), efforts)
