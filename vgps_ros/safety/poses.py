# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Motions without a policy: standing up, holding and sitting down, by PD towards a pose."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.core.settings import Range
from vgps_ros.robot.controls import Controls

_LONGEST = 0.1  # time between two states that counts for a correction [s]


@dataclass(frozen=True)
class PoseSettings:
    """How a robot gets to a pose, and from which one its policy drives."""

    stand_duration: Annotated[
        float,
        Range(0.0, 60.0),
        "time in which the joints go from where they are measured to the pose in which the robot "
        "stands, after an activation and before the policy drives; 0: it drives at once [s]",
    ] = 0.0
    stand_keyframe: Annotated[
        str, "keyframe of the model in which the robot stands; empty: the task's initial state"
    ] = ""
    sit_duration: Annotated[float, Range(0.0, 60.0), "time in which the robot sits down [s]"] = 2.0
    sit_keyframe: Annotated[
        str, "keyframe in which it sits; empty: it sinks, as its motors become soft where it is"
    ] = ""
    pose_stiffness: Annotated[
        float, Range(0.0, 1e6), "torque of a motor per deviation of its joint [N·m/rad]"
    ] = 60.0
    pose_damping: Annotated[
        float,
        Range(0.0, 1e6),
        "torque of a motor per velocity of its joint; with too much, joints chatter at the rate of "
        "the commands [N·m·s/rad]",
    ] = 1.0
    pose_integral: Annotated[
        float,
        Range(0.0, 100.0),
        "rate at which what a joint lacks of its pose is added to what is asked of it, so that it "
        "does not sag under the robot's weight; 0: it sags [1/s]",
    ] = 1.0
    pose_correction: Annotated[
        float, Range(0.0, 1e3), "most that is added so in either direction [rad, m]"
    ] = 0.5


class PoseMotion:
    """Moves the joints from where they are to a pose, and keeps them there.

    It begins with what the last control has asked for, which carried the robot's weight.

    Args:
        name: what the robot does, for people.
        controls: what its controls are.
        settings: the gains.
        goal: a state in the pose, shape (n_x,); None: where the joints are, and in a motion of some
            duration the motors become soft.
        duration: time of the motion [s].
        first: a state from whose pose the joints go, shape (n_x,); None: where they are measured.
        last: the last control, shape (n_u,), with which it begins; None: it begins without pull.
        is_before_law: whether the law drives once the pose is reached.

    Attributes:
        is_reached: whether the motion has ended.
    """

    def __init__(
        self,
        name: str,
        controls: Controls,
        settings: PoseSettings,
        goal: Array | None,
        duration: float,
        first: Array | None = None,
        last: Array | None = None,
        *,
        is_before_law: bool = False,
    ):
        self.name, self.is_reached, self.is_before_law = name, False, is_before_law
        self._controls, self._settings = controls, settings
        self._goal, self._duration = goal, duration
        self._first, self._last = first, last
        self._begin: tuple[int, Array] | None = None  # stamp [ns] and state
        self._newest = 0  # stamp [ns]
        self._correction = np.zeros(len(controls.names))

    def control(self, state: Array, stamp: int) -> Array:
        """Returns u in a state (n_x,) with a stamp [ns], shape (n_u,)."""
        settings = self._settings
        most = settings.pose_correction
        if self._begin is None or stamp < self._begin[0]:
            first = state if self._first is None else self._first
            if self._begin is None and self._last is not None:
                gains = settings.pose_stiffness, settings.pose_damping
                asked = self._controls.asked(first, self._last, *gains)
                if (np.abs(asked) <= most).all():  # else it is too far away to have carried it
                    self._correction = asked
            self._begin, self._newest = (stamp, first), stamp
        began, first = self._begin
        passed = (stamp - began) * 1e-9
        share = min(1.0, passed / self._duration) if self._duration else 1.0
        self.is_reached = share >= 1.0
        at, held = first, 1.0
        if self._goal is not None:
            at = first + share * share * (3.0 - 2.0 * share) * (self._goal - first)
        elif self._duration:
            held = 1.0 - share
        lacking = self._controls.positions @ (at - state)
        elapsed = min(max(0, stamp - self._newest) * 1e-9, _LONGEST)
        self._newest = max(stamp, self._newest)
        grown = self._correction + settings.pose_integral * elapsed * lacking
        self._correction = np.clip(grown, -most, most)
        gains = held * settings.pose_stiffness, settings.pose_damping
        return self._controls.pulling(state, at, *gains, held * self._correction)
