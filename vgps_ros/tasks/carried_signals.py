# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The clock of a task along the states of a running robot, and how far contexts lie apart."""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.observation import Observation
from vgps_ros.core.records import Array
from vgps_ros.tasks.signals import Signals

LONGEST = 10.5  # control periods between two states, after more of which the clock starts anew
_SHARE_OF_RANGE, _OF_CLOCK = 0.25, 0.5  # standard deviations of a command and of the clock


@dataclass(frozen=True)
class _Moment:
    stamp: int  # of a state [ns]
    phase: float  # φ there
    moves: bool  # whether the clock turns from there on


class CarriedClock:
    """Carries φ from state to state by their stamps.

    The clock starts at 0 where it did not turn before, where time goes back, and after a gap. A
    state that is answered twice has the same phase twice: it follows from an earlier state, the
    newest one of another stamp.

    Args:
        signals: the commands and the clock.
    """

    def __init__(self, signals: Signals):
        self._signals = signals
        self._latest: _Moment | None = None
        self._earlier: _Moment | None = None

    def phase(self, stamp: int, commands: Array) -> float:
        """Returns φ in a state of a stamp [ns] while the commands are (n_c,)."""
        if self._latest and stamp != self._latest.stamp:
            self._earlier = self._latest
        moves = bool(self._signals.moves(commands))
        before = self._earlier
        phase = 0.0
        if moves and before and before.moves:
            passed = (stamp - before.stamp) * 1e-9
            if 0.0 <= passed <= LONGEST * self._signals.time_step:
                phase = (before.phase + self._signals.frequency * passed) % 1.0
        self._latest = _Moment(stamp, phase, moves)
        return phase


def spread_of_told(signals: Signals, observation: Observation) -> Array:
    """Returns standard deviations of what an observation reads of the context, shape (c,).

    By them a distance from a training judges other commands, since a policy learns from some
    commands what to do in all between them.
    """
    ranges = [_SHARE_OF_RANGE * (c.highest - c.lowest) for c in signals.commands]
    clock = [_OF_CLOCK] * (len(signals.names) - len(ranges))
    return np.array([*ranges, *clock])[list(observation.columns)]
