# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The states of a bag that its executor had to answer, and their answers."""

from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import mujoco

from vgps_ros.bags import BagReader
from vgps_ros.bags.executor_log import ExecutorLog
from vgps_ros.bags.states import recorded_states
from vgps_ros.bags.timeline import SLACK, Timeline
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import nanoseconds
from vgps_ros.messages.robot_state import JOINTS, StateMessages


@dataclass(frozen=True)
class _Run:
    """States of one stamp that came one after the other; a paused simulation repeats its state."""

    stamp: int
    received: int  # the first one [ns]


class Unanswered(NamedTuple):
    """Numbers of states that lack a torque.

    Attributes:
        known: of those at whose time the executor said that a policy drove.
        unknown: of those at whose time it said nothing.
    """

    known: int
    unknown: int


class AnsweredStates:
    """The usable states of a bag by their stamps, and the times of the torques that answer them.

    Attributes:
        unusable: number of states that no torque may answer, such as one that is not finite.
        begin: time at which the first state came, usable or not [ns]; 0 if there is none.

    Raises:
        InvalidInputError: the bag lacks a topic of the states, or a message fits no definition.
    """

    def __init__(self, bag: BagReader, model: mujoco.MjModel):
        self.unusable = self.begin = 0
        self._states: dict[int, Timeline] = defaultdict(Timeline)
        self._runs: list[_Run] = []
        self._answers: dict[int, list[int]] = defaultdict(list)
        messages_of = StateMessages(model)
        for received, messages in recorded_states(bag, messages_of):
            self.begin = self.begin or received
            try:
                state = messages_of.join(messages)
            except InvalidInputError:
                self.unusable += 1
            else:
                stamp = nanoseconds(messages[JOINTS].header.stamp)
                self._states[stamp].add(received, state)
                if not self._runs or self._runs[-1].stamp != stamp:
                    self._runs.append(_Run(stamp, received))

    def around(self, stamp: int, time: int) -> list[Array]:
        """Returns the states of a stamp that torques of a time [ns] may answer, likeliest first."""
        return self._states[stamp].around(time) if stamp in self._states else []

    def note_answer(self, stamp: int, time: int) -> None:
        """Notes torques that came at a time [ns] and answer the state of a stamp."""
        self._answers[stamp].append(time)

    def unanswered(self, log: ExecutorLog, begin: int, *, is_in_lock_step: bool) -> Unanswered:
        """Counts the states that lack a torque, although a policy drove when they came.

        In lock-step a later state proves that the one before it was answered. The newest states of
        a bag may lack a torque, since their answers may have come after its end.

        Args:
            log: what the executor said of its activity.
            begin: time from which on there was a policy [ns], for an executor that did not say so.
            is_in_lock_step: true if a simulation waited for each torque.
        """
        known = unknown = 0
        for run, following in pairwise(self._runs):
            drove = log.was_ready(run.received) if log.counts else run.received > begin
            is_silent = log.counts and not log.knows(run.received)
            if not (drove or is_silent) or log.has_fault(run.received):
                continue
            if is_in_lock_step and following.stamp < run.stamp:
                continue  # a reset, which needs no answer
            times = self._answers.get(run.stamp, [])
            first = bisect_left(times, run.received - SLACK)
            if first == bisect_right(times, following.received + SLACK):
                known, unknown = known + (not is_silent), unknown + is_silent
        return Unanswered(known, unknown)

    def absent(self, period: int) -> int:
        """Returns how many states are missing between those of a simulation in lock-step.

        Args:
            period: time from state to state [ns].
        """
        steps = (later.stamp - run.stamp for run, later in pairwise(self._runs))
        return sum(max(0, round(step / period) - 1) for step in steps)

    def surplus(self, answers: Counter[int]) -> int:
        """Returns how many of a policy's torques are more than the states that they answer.

        Args:
            answers: number of its torques by stamp.
        """
        states = {stamp: len(self._states[stamp].received) for stamp in answers}
        return sum(max(0, count - states[stamp]) for stamp, count in answers.items())

    def disordered(self, stamps: list[int]) -> int:
        """Returns how often the stamps of a policy's torques go back where those of states do not.

        Args:
            stamps: those of the torques, in the order in which they were received [ns].
        """
        resets = sum(later.stamp < run.stamp for run, later in pairwise(self._runs))
        return max(0, sum(later < stamp for stamp, later in pairwise(stamps)) - resets)
