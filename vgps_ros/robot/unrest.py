# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Tells when a robot that stands has to step, so that a clock that stops turns again.

It is restless while its base is tilted from how it starts, or turns about a level axis: both are
felt by an inertial unit, 40 to 80 ms after the begin of a push. A quadruped of 12 kg that steps on
the spot tilts by 0.03 rad and turns at up to 0.5 rad/s; pushes of 5 N·s leave it at rest, and from
15 N·s on all make it restless.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.records import Array
from vgps_ros.robot.bodies import UP, StateLayout, vertical
from vgps_ros.robot.signals import Signals

TILT = 0.07  # [rad]
RATE = 0.7  # [rad/s]
_LASTS = 1.5  # time for which the clock turns after the robot was restless [s]


@dataclass(frozen=True, eq=False)
class Unrest:
    """When a robot on a free base is restless.

    Attributes:
        rotation: where a state has the base's quaternion.
        rate: where it has the base's angular velocity.
        up: the vertical in the base's axes, in how it starts on level ground, shape (3,).
        vertical: the vertical in the world's axes, shape (3,); the slope of the ground tilts it.
        steps: control steps for which the clock turns after the robot was restless.
    """

    rotation: int
    rate: int
    up: Array
    vertical: Array
    steps: int

    @classmethod
    def of(
        cls, signals: Signals, layout: StateLayout, start: Array, up: Array = UP
    ) -> "Unrest | None":
        """Returns that of a robot that starts in a state (n_x,); None if its clock never stops.

        The vertical is `up` (3,) in the world's axes.
        """
        base = layout.base
        if not signals.stops or base is None:
            return None
        rotation, rate = base.first_position + 3, base.first_velocity + 3
        level = vertical(start[rotation : rotation + 4])
        return cls(rotation, rate, level, up, round(_LASTS / signals.time_step))

    def restless(self, states: Array) -> NDArray[np.bool_]:
        """Returns whether the robot is restless, shape (...,), in states (..., n_x)."""
        up = vertical(states[..., self.rotation : self.rotation + 4], self.vertical)
        turning = states[..., self.rate : self.rate + 3]
        level = turning - (turning * up).sum(axis=-1, keepdims=True) * up
        is_tilted = (up * self.up).sum(axis=-1) < np.cos(TILT)
        return np.asarray(is_tilted | ((level**2).sum(axis=-1) > RATE**2))

    def awake(self, states: Array) -> NDArray[np.bool_]:
        """Returns whether the clock turns in each state of a motion, (T,) of (T, n_x)."""
        at, restless = np.arange(len(states)), self.restless(states)
        last = np.maximum.accumulate(np.where(restless, at, -self.steps))
        return np.asarray(at - last < self.steps)


class Waking:
    """Says of one state after another whether the clock turns though all commands are at rest."""

    def __init__(self, unrest: Unrest, time_step: float):
        self._unrest, self._lasts = unrest, round(unrest.steps * time_step * 1e9)
        self._until = 0  # stamp up to which it turns [ns]

    def is_awake(self, state: Array, stamp: int) -> bool:
        """Returns it for a state (n_x,) with a stamp [ns]; an earlier stamp begins anew."""
        if self._until - stamp > self._lasts:
            self._until = 0
        if self._unrest.restless(state):
            self._until = stamp + self._lasts
        return stamp < self._until
