"""The robot that the node `simulation` holds: its state, its time, its limits."""

import mujoco
import numpy as np

from vgps_ros.core.dynamics import DIVERGENCE_BOUND
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.tasks import Task


class SimulatedRobot:
    """A task's dynamics with a state and a clock.

    Attributes:
        state: x, shape (n_x,).
        efforts: torques that led to this state, one a joint [N·m].
        previous_stamp: time of the state before this one [ns].
    """

    def __init__(self, task: Task, state: Array):
        self._task = task
        self._steps = 0
        self.state = state
        self.efforts = np.zeros(len(task.joint_names))
        self.previous_stamp = -1
        self._actuated = [task.joint_names.index(name) for name in task.actuated_joint_names]

    @property
    def stamp(self) -> int:
        """Simulated time [ns]; from a count of steps, so that it does not drift."""
        return round(self._steps * self._task.dynamics.time_step * 1e9)

    def check(self, command: Array) -> None:
        """Checks torques that come from outside.

        Raises:
            InvalidInputError: one is so large that MuJoCo would put zero in its place.
        """
        too_large = np.abs(command) >= mujoco.mjMAXVAL
        if too_large.any():
            first = np.argmax(too_large)
            raise InvalidInputError(
                f"joint_command.effort is {command[first]:g} at index {first}; every value "
                f"must be below {mujoco.mjMAXVAL:g}."
            )

    def advance(self, command: Array) -> None:
        """Holds torques, shape (n_u,), [N·m], for one control step.

        Raises:
            DivergenceError: the next state is out of bounds; the robot keeps the one it has.
        """
        state = self._task.dynamics.step(self.state, command)
        # A NaN fails the comparison too.
        inside = np.abs(state) < DIVERGENCE_BOUND
        if not inside.all():
            names, first = self._task.joint_names, np.argmin(inside)
            kind = "position" if first < len(names) else "velocity"
            raise DivergenceError(
                f"The state diverged at {self.stamp * 1e-9:g} s: the {kind} of "
                f"{names[first % len(names)]} became {state[first]:g}. The simulation is "
                "paused; reset it, and check the policy and the initial state."
            )
        self.previous_stamp = self.stamp
        self.state = state
        self.efforts[self._actuated] = command
        self._steps += 1

    def reset(self, state: Array | None, *, time: bool) -> None:
        """Puts the robot into a state, where one is given, and its time to 0, where asked."""
        self.previous_stamp = self.stamp
        if state is not None:
            self.state = state
            self.efforts[:] = 0.0
        if time:
            self._steps = 0
