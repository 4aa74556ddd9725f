# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a robot's executor has to know of a task; `policies.deployment_file` writes it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.checks import one_of
from vgps_ros.core.observation import Observation, StateReadings
from vgps_ros.core.records import Array
from vgps_ros.robot.bodies import StateLayout
from vgps_ros.robot.controls import Controls
from vgps_ros.robot.signals import Signals

Reader = Callable[[Sequence[str]], StateReadings]


@dataclass(frozen=True)
class Conditions:
    """Says whether any reading is outside its range.

    Attributes:
        readings: the r readings.
        lowest: smallest value of each, shape (r,); -inf for none.
        highest: largest value of each, shape (r,); inf for none.
    """

    readings: StateReadings
    lowest: Array
    highest: Array

    def broken(self, state: Array) -> str:
        """Says which reading of a state (n_x,) is outside its range; empty where none is."""
        if not self.lowest.size:
            return ""
        rows = zip(
            self.readings.names, self.readings(state), self.lowest, self.highest, strict=True
        )
        return next(
            (
                f"{name} is {value:.3g}, but the task allows {low:g} to {high:g}."
                for name, value, low, high in rows
                if not low <= value <= high
            ),
            "",
        )

    def __call__(self, states: Array) -> NDArray[np.bool_]:
        """Returns whether one is outside, shape (...,), for states (..., n_x); a NaN is not."""
        if not self.lowest.size:
            return np.zeros(states.shape[:-1], dtype=bool)
        values = self.readings(states)
        return np.any((values < self.lowest) | (values > self.highest), axis=-1)


@dataclass(frozen=True)
class Deployment:
    """What an executor has to know of a task.

    Attributes:
        name: the task's name.
        mjcf: the robot's MJCF, which bags need; nothing here compiles it.
        time_step: time of a control step [s].
        horizon: T, the number of steps of a trajectory distribution that were trained on.
        layout: what the numbers of a state are.
        controls: what the robot's controls are.
        signals: the commands and the clock.
        initial_state: in which the robot stands, shape (n_x,).
        keyframes: other poses by name, as states at rest, shape (n_x,).
        carrying: forces τ of the servos that hold such a pose under the robot's weight, by its
            name, that of the initial state is empty; shape (n_u,) [N·m, N].
        observation: what a policy of the task reads.
        limits: in which states the policy must not drive.
        read: returns readings by their names, for a third-party policy.
        sensors: names of the readings that sensors of the model give.
    """

    name: str
    mjcf: str
    time_step: float
    horizon: int
    layout: StateLayout
    controls: Controls
    signals: Signals
    initial_state: Array
    keyframes: dict[str, Array]
    carrying: dict[str, Array]
    observation: Observation
    limits: Conditions
    read: Reader
    sensors: tuple[str, ...] = ()

    def pose(self, setting: str, keyframe: str) -> Array:
        """Returns the state of a keyframe at rest, shape (n_x,); the initial one, if it is empty.

        Raises:
            InvalidInputError: there is no such keyframe; the error names the setting.
        """
        if not keyframe:
            return self.initial_state
        one_of(setting, keyframe, list(self.keyframes))
        return self.keyframes[keyframe]

    def standing(self, keyframe: str, controls: Controls) -> Array | None:
        """Returns u by which a robot on a free base stands in a pose, (n_u,); None of another one.

        Args:
            keyframe: name of the pose; empty for the initial state.
            controls: the robot's, perhaps with gains of a policy.
        """
        if self.layout.base is None:
            return None
        pose = self.keyframes.get(keyframe, self.initial_state)
        return controls.carrying(pose, self.carrying[keyframe])
