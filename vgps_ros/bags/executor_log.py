# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads what a recorded executor said of itself: its commands, activity and faults."""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.timeline import SLACK
from vgps_ros.messages.names import (
    COMMANDS_SENT,
    IS_ACTIVE,
    OWNS,
    POLICY_OF_ITERATION,
    SAFE_ACTION,
    SAFE_ACTION_DRIVES,
)

QUIET = 3 * 10**9  # without a word from the executor, after which nothing is known of it [ns]


class _Status(NamedTuple):
    received: int  # [ns]
    life: int  # which start of the node
    sent: int | None  # commands so far; None of a version that did not count
    is_ready: bool  # active, with a policy
    has_fault: bool


@dataclass(frozen=True)
class Counted:
    """The executor's own count of its commands beside that of the bag.

    Attributes:
        sent: commands that the executor counted while it was recorded.
        missing: commands that the bag must lack at least.
        surplus: commands that the bag holds beyond those.
    """

    sent: int
    missing: int
    surplus: int


class ExecutorLog:
    """The diagnostics of a bag's executor.

    Args:
        bag: the bag; one without diagnostics tells nothing.
        commands: topic of the executor's commands, which its diagnostics name as its own.
    """

    def __init__(self, bag: BagReader, commands: str):
        self._all: list[_Status] = []
        topic = bag.filled_topics.get("diagnostics")
        for received, message in bag.decoded(topic) if topic else ():
            for status in message.status:
                if not bag.of_robot([status.name]):
                    continue  # all robots of a domain share the topic
                values = {pair.key: pair.value for pair in status.values}
                is_its_own = commands in values.get(OWNS, commands).split()
                is_safe = values.get(SAFE_ACTION) == "True" or SAFE_ACTION_DRIVES in status.message
                if is_its_own and (COMMANDS_SENT in values or is_safe):
                    self._add(received, values, is_safe)
        if self.counts:  # so each of its statuses does
            self._all = [status for status in self._all if status.sent is not None]
        self._received = [status.received for status in self._all]

    @property
    def counts(self) -> bool:
        """True if the executor counted its commands, as all versions do that state their bits."""
        return any(status.sent is not None for status in self._all)

    def knows(self, time: int) -> bool:
        """Returns whether the executor said anything shortly before or after a time [ns].

        What came before its first status is known, too, if it had sent nothing until then.
        """
        at = bisect_right(self._received, time)
        around = self._received[max(0, at - 1) : at + 1]
        is_first = at == 0 and bool(self._all) and not self._all[0].sent
        return is_first or any(abs(received - time) <= QUIET for received in around)

    def has_fault(self, time: int) -> bool:
        """Returns whether the safe action may have driven at a time [ns].

        A fault is said at once, and again until it is over.
        """
        begin = bisect_right(self._received, time - SLACK)
        end = bisect_right(self._received, time + SLACK)
        return any(status.has_fault for status in self._all[max(0, begin - 1) : end])

    def was_ready(self, time: int) -> bool:
        """Returns whether the executor was active and had a policy at a time [ns].

        The statuses before and after say so; a bag may end before there is one after.
        """
        at = bisect_left(self._received, time)
        around = self._all[max(0, at - 1) : at + 1]
        return at > 0 and all(s.is_ready and s.life == around[0].life for s in around)

    def has_ended(self, time: int) -> bool:
        """Returns whether the executor was stopped at a time [ns]: its next status says so.

        There may also be none, or that of another start of the node.
        """
        at = bisect_right(self._received, time)
        if at == len(self._all):
            return True
        after = self._all[at]
        return not after.is_ready or (at > 0 and after.life != self._all[at - 1].life)

    def count(self, commands: list[int]) -> Counted:
        """Compares the executor's counts with the times at which commands were received [ns].

        Each status bounds from both sides how many were sent before the recording began, since a
        command is recorded at most the slack before or after a status of the same moment.
        """
        sent = missing = surplus = 0
        for _, life in groupby(self._all, lambda status: status.life):
            known = [(s.received, s.sent) for s in life if s.sent is not None]
            if not known:
                continue
            first = bisect_left(commands, known[0][0] - SLACK)
            least, most = 0, known[0][1]
            for received, number in known:
                least = max(least, number - bisect_right(commands, received + SLACK) + first)
                most = min(most, number - bisect_left(commands, received - SLACK, first) + first)
            sent += known[-1][1] - known[0][1]
            missing += max(0, least - max(most, 0))
            surplus += max(0, -most)
        return Counted(sent, missing, surplus)

    def _add(self, received: int, values: dict[str, str], has_fault: bool) -> None:
        text = values.get(COMMANDS_SENT, "")
        sent = int(text) if text.isascii() and text.isdecimal() and len(text) < 20 else None
        is_ready = values.get(IS_ACTIVE) == "True" and POLICY_OF_ITERATION in values
        before = self._all[-1] if self._all else None
        is_other = before is not None and (sent or 0) < (before.sent or 0)
        life = before.life + is_other if before else 0
        self._all.append(_Status(received, life, sent, is_ready, has_fault))
