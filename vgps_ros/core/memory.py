# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a policy reads of former steps: readings and its last action.

One reading says little of what a sensor does not measure, or measures with noise; a few of them do.
With readings y of a step, the memory of step t is

    m_t = (y_{t−1}, …, y_{t−H}, u_{t−1}).

At a start there is nothing to remember: all readings were as the first ones, and the last action
was the control that leaves the robot alone where its task starts. Whoever executes a policy carries
its memory. An action is remembered with its noise and within the robot's limits, but as the policy
chose it, whatever a supervisor then sent in its place.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vgps_ros.core.records import Array

LAST_ACTION = "last_action"
_PAST = re.compile(r"past/(\d+)/(.+)")  # steps ago, and the reading


class Memory(NamedTuple):
    """What N robots side by side remember: actions (N, n_a), and frames (N, L, n_f)."""

    action: Array
    frames: Array


@dataclass(frozen=True, eq=False)
class PastInputs:
    """The numbers m_t of the memory.

    Attributes:
        readings: names of the readings y of a step; there are r.
        history: H, steps whose readings are read again; the newest comes first.
        actions: names of the controls, if the last action is read; otherwise empty.
        resting: the last action at a start, shape (n_u,).
        limits: of the controls, lowest and highest, shape (n_u,) each.
    """

    readings: tuple[str, ...]
    history: int
    actions: tuple[str, ...]
    resting: Array
    limits: tuple[Array, Array]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers."""
        lags = range(1, self.history + 1)
        past = [f"past/{lag}/{name}" for lag in lags for name in self.readings]
        return (*past, *(f"{LAST_ACTION}/{name}" for name in self.actions))

    @property
    def length(self) -> int:
        """Number of former steps of which the memory tells."""
        return max(self.history, 1)

    def following(self, memory: Memory | None, read: Array) -> Memory:
        """Returns the memory with the newest readings (N, r) as its first frame."""
        if memory is None:
            frames = np.repeat(read[:, None], self.history + 1, axis=1)
            return Memory(np.tile(self.resting, (len(read), 1)), frames)
        return memory._replace(frames=np.concatenate([read[:, None], memory.frames[:, :-1]], 1))

    def acted(self, memory: Memory, controls: Array) -> Memory:
        """Returns the memory after controls (N, n_u)."""
        return memory._replace(action=np.clip(controls, *self.limits))

    def numbers(self, memory: Memory) -> Array:
        """Returns y_t and m_t, shape (N, r + n_m), of a memory whose first frame is y_t."""
        action = memory.action if self.actions else memory.action[:, :0]
        return np.concatenate([memory.frames.reshape(len(action), -1), action], axis=1)

    def along(self, read: Array, controls: Array) -> Array:
        """Returns m_t, shape (..., T, n_m), along motions from their starts.

        Args:
            read: y_t, shape (..., T, r).
            controls: u_t, shape (..., T, n_u).
        """
        steps = np.arange(read.shape[-2])
        past = [read[..., np.maximum(steps - lag, 0), :] for lag in range(1, self.history + 1)]
        return self.joined(past, np.roll(controls, 1, axis=-2))

    def joined(self, past: Sequence[Array], actions: Array) -> Array:
        """Returns m_t, shape (..., T, n_m), of its parts.

        Args:
            past: y_{t−1} … y_{t−H}, shape (..., T, r) each.
            actions: u_{t−1}, shape (..., T, n_u); that of the first step does not count.
        """
        if not self.actions:
            return np.concatenate(past, axis=-1)
        actions = np.clip(actions, *self.limits)
        actions[..., 0, :] = self.resting
        return np.concatenate([*past, actions], axis=-1)


def terms_of(names: Sequence[str]) -> list[tuple[str, int]]:
    """Returns the terms of which inputs consist, each with how many steps ago it was read.

    The numbers of the last action are one term.
    """
    found = list[tuple[str, int]]()
    for name in names:
        past = _PAST.fullmatch(name)
        is_action = name.startswith(f"{LAST_ACTION}/")
        term = LAST_ACTION if is_action else past[2] if past else name
        if not (is_action and found and found[-1][0] == LAST_ACTION):
            found.append((term, int(past[1]) if past else 0))
    return found


def reading_of(name: str) -> str:
    """Returns the name of the reading of which an input tells, in this step or a former one."""
    past = _PAST.fullmatch(name)
    return past[2] if past else name
