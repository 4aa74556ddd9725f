# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a fault campaign hears of the graph, as one more listener."""

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import JointState
from vgps_msgs.msg import LearningProgress, OptimizerIteration

from tests.faults.records import Published, Recording
from vgps_ros.ros_runtime.qos import NEWEST, SIGNS_OF_LIFE, STREAM

KEPT = {  # what must be in the bags, by who publishes it
    "policy_learner": "/learning_progress",
    "trajectory_optimizer": "/trajectory_optimizer/iterations",
}
STARTED = 0.5  # before that a node has not even read its program: what comes is another's [s]
FOUND = 1.0  # in which all others have found a node after the first one [s]
RESENT = 3.0  # after which a publisher sends again what a busy reader has missed, at most [s]


class Listener:
    """Follows the streams and /diagnostics.

    Args:
        node: whose subscriptions these are.

    Attributes:
        published: what must be in the bags.
        said: the latest status of each node.
        recording: the bag that the recorder is writing.
    """

    def __init__(self, node: Node):
        self._node = node
        self.published: list[Published] = []
        self.said: dict[str, DiagnosticStatus] = {}
        self.recording: Recording | None = None
        self._words: list[tuple[float, str, str]] = []  # when who said what
        self._heard: dict[str, float] = {}  # when something came on each topic
        self._last: list[tuple[str, float]] = []  # topics of nodes that were killed, and when
        self._first: list[tuple[str, float]] = []  # topics of new nodes, and when they were heard
        self._begun: dict[str, float] = {}  # when those were started that were not heard yet
        self._subscribe(LearningProgress, KEPT["policy_learner"], STREAM, keep=True)
        self._subscribe(OptimizerIteration, KEPT["trajectory_optimizer"], STREAM, keep=True)
        self._subscribe(JointState, "/joint_states", NEWEST)
        self._subscribe(JointState, "/joint_command", NEWEST)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take_words, SIGNS_OF_LIFE)

    def started(self, name: str) -> None:
        """Notes that a node was started."""
        if name in KEPT:
            self._begun[name] = time.monotonic()

    def killed(self, name: str) -> None:
        """Notes that a node was killed."""
        if name in KEPT:
            self._last.append((KEPT[name], time.monotonic()))

    def forget_words(self) -> None:
        """Forgets what nodes have said so far."""
        self._words.clear()

    def forget(self) -> None:
        """Forgets which streams flow and how nodes are."""
        self._heard.clear()
        self.said.clear()

    def who_said(self, text: str) -> dict[str, float]:
        """Returns the nodes that said this since `forget_words`, and when first [s]."""
        said: dict[str, float] = {}
        for when, name, words in self._words:
            if text in words:
                said.setdefault(name, when)
        return said

    def words_of(self, name: str) -> str:
        """Returns all that a node said since `forget_words`, and how long ago, for a person."""
        now = time.monotonic()
        words = [(when, said) for when, who, said in self._words if who == name]
        listed = ", ".join(f"'{said}' {now - when:.1f} s ago" for when, said in words)
        return f"{name} said {listed or 'nothing'}"

    def missing(self, names: tuple[str, ...]) -> list[str]:
        """Returns sentences on the nodes that are not well, and the streams that do not flow."""
        silent = {"/joint_states", "/joint_command"} - self._heard.keys()
        if not set(KEPT.values()) & self._heard.keys():
            silent.add(KEPT["policy_learner"])
        missing = [f"Nothing comes on {topic}." for topic in sorted(silent)]
        for name in names:
            status = self.said.get(f"/{name}")
            if status is None or not _is_well(status):
                missing.append(f"/{name}: {status.message if status else 'nothing'}")
        return missing

    def expects(self, message: Published, recording: Recording) -> bool:
        """Returns whether a bag must hold a message.

        A killed node's last words may be lost: they may have reached this process, and been taken
        only after the kill; or the recorder may have missed them at first, and nobody was left to
        send them again. So may a new node's first words: it may have found this process before the
        recorder, and a stream keeps nothing for those who come later.
        """
        last = any(
            topic == message.topic and -1.0 < moment - message.time < 1.0 + RESENT
            for topic, moment in self._last
        )
        first = any(
            topic == message.topic and abs(message.time - moment) < FOUND
            for topic, moment in self._first
        )
        return recording.covers(message.time) and not (last or first)

    def _subscribe(self, kind: type, topic: str, qos: Any, *, keep: bool = False) -> None:
        def take(message: Any, info: dict[str, int]) -> None:
            """Notes that it came, and keeps it as CDR."""
            self._heard[topic] = time.monotonic()
            if keep:
                self.published.append(Published(_published(info), topic, message))

        self._node.create_subscription(kind, topic, take, qos, raw=keep)

    def _take_words(self, message: DiagnosticArray, info: dict[str, int]) -> None:
        now = _published(info)
        for status in message.status:
            name = status.name.lstrip("/")
            if now - self._begun.get(name, now) > STARTED:
                self._first.append((KEPT[name], now))
                del self._begun[name]
            self.said[status.name] = status
            self._words.append((now, status.name, status.message))
            if status.name == "/recorder" and status.level == DiagnosticStatus.OK:
                self._follow_recorder({value.key: value.value for value in status.values}, now)

    def _follow_recorder(self, values: dict[str, str], now: float) -> None:
        """Opens the bag's window once it records all topics."""
        there = {
            name
            for name, _ in self._node.get_topic_names_and_types()
            if "/_" not in name and self._node.count_publishers(name)
        }
        bag = self.recording
        if bag and not bag.is_open and not bag.ended and int(values.get("topics", 0)) >= len(there):
            bag.windows.append([now, float("inf")])


def _published(info: dict[str, int]) -> float:
    """Returns when a message was published [s], which may be long before it is taken here."""
    return time.monotonic() - 1e-9 * (time.time_ns() - info["source_timestamp"])


def _is_well(status: DiagnosticStatus) -> bool:
    """A node may warn, as of a fit that gains nothing, but it must not miss another one."""
    warns = status.level == DiagnosticStatus.WARN and "silent" not in status.message
    return warns or status.level == DiagnosticStatus.OK
