# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Subscriptions that bound the memory which the messages of others can take of a node.

The middleware bounds how many messages wait for a node, not how large they are: a thousand messages
of 8 MB take 8 GB, which Fast DDS gives back only with the subscription, unless its profile is that
of `env.bash`. So two bounds are added here: a message that is larger than its topic needs is
dropped before it is unpacked, and where the memory rises too far, the heaviest topics give up what
waits there. What a backlog took and the C library keeps for later is given back.
"""

import copy
import os
import time
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message

from vgps_ros.ros_runtime.c_memory import trim
from vgps_ros.ros_runtime.rclpy_internals import discard_unread
from vgps_ros.ros_runtime.steady_timer import steady_timer

LARGEST_RECORD = 2**26  # of a policy or a trajectory distribution [bytes]
_LARGEST = 2**20  # of any other message, such as a state of thousands of joints [bytes]

_BUDGET = 256.0  # that the memory may rise above its floor before messages are given up [MB]
_FLOOR_RISES = 1.0  # as fast as a node's memory may grow by what it keeps on purpose [MB/s]
_SHARE = 16.0  # that the unread messages of one topic may take after that [MB]
_PERIOD = 0.2  # between two looks at the memory [s]
_LOOKS = 5  # between two trims of the C library's memory
_LARGE = 2**14  # from which on even few messages leave memory there that is not used again [bytes]
_LEFT = 2**20  # taken in such messages, after which it is trimmed [bytes]
_SHOWN = 3.0  # in which a warning stays after the last message that was dropped [s]
_DISCARDING = 0.2  # in which messages that are given up are counted [s]


class _Stream:
    """One topic's subscription, which can be made anew with a shorter queue.

    Attributes:
        topic: its name.
        largest: size of the largest message that was taken [bytes].
        is_raw: whether the node takes messages of any size.
    """

    def __init__(self, topic: str, qos: QoSProfile, subscribe: Callable[..., Any], *, is_raw: bool):
        self.topic = topic
        self.is_raw = is_raw
        self.largest = 0
        self._qos = qos
        self._subscribe = subscribe
        # Latched messages come a second time after the subscription was made anew.
        is_latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._taken: deque[int] = deque(maxlen=qos.depth if is_latched else 0)
        self._repeated: set[int] = set()
        self._subscription = subscribe(qos)

    @property
    def weight(self) -> float:
        """Memory of the queue, if it is full of messages as large as the largest [MB]."""
        return self._qos.depth * self.largest * 1e-6

    def is_repeated(self, info: dict[str, int]) -> bool:
        """Returns whether a message came before the subscription was made anew, too."""
        sent = info["source_timestamp"]
        self._taken.append(sent)
        return sent in self._repeated

    def shorten(self, node: Node) -> int:
        """Gives up what is unread; from now on the queue is short. Returns how many were there."""
        count = discard_unread(self._subscription, time.monotonic() + _DISCARDING)
        node.destroy_subscription(self._subscription)
        self._qos.depth = max(1, int(_SHARE * 1e6 / self.largest))
        self._repeated = set(self._taken)
        self._subscription = self._subscribe(self._qos)
        return count


class Inbox:
    """A node's subscriptions.

    Args:
        node: the node.

    Attributes:
        kept: returns the memory that the node itself keeps for a while on purpose [bytes].
        dropped: number of messages that were dropped, by topic; at least, since there is not always
            the time to count those that were given up.
        lost: number of those among them that a raw subscription should have taken.
    """

    def __init__(self, node: Node):
        self.kept: Callable[[], int] = lambda: 0
        self.dropped: Counter[str] = Counter()
        self.lost = 0
        self._node = node
        self._streams: list[_Stream] = []
        self._said: dict[str, tuple[float, str]] = {}  # when a sentence was last true, by topic
        self._floor = float("inf")
        # Since the C library's memory was trimmed: in all messages, and in large ones [bytes].
        self._taken = self._taken_large = 0
        self._looks = 0
        steady_timer(node, _PERIOD, self._look)

    def subscribe(
        self,
        kind: Any,
        topic: str,
        take: Callable[[Any], object],
        qos: QoSProfile,
        *,
        largest: int = _LARGEST,
    ) -> None:
        """Calls a function with each message of a topic that is not larger than allowed [bytes]."""

        def receive(data: bytes) -> None:
            self._note(stream, data)
            if len(data) > largest:
                sentence = f"larger than {largest * 1e-6:.1f} MB, which is more than it needs"
                self._drop(topic, 1, sentence)
                return
            try:
                message = deserialize_message(data, kind)
            except Exception:  # rclpy's own has no public name
                self._drop(topic, 1, f"no valid {kind.__name__}")
                return
            take(message)

        stream = _Stream(
            topic,
            copy.copy(qos),
            lambda qos: self._node.create_subscription(kind, topic, receive, qos, raw=True),
            is_raw=False,
        )
        self._streams.append(stream)

    def subscribe_raw(
        self,
        kind: Any,
        topic: str,
        take: Callable[[bytes, dict[str, int]], object],
        qos: QoSProfile,
        events: SubscriptionEventCallbacks,
    ) -> None:
        """Calls a function with each message as CDR, of any size, and with its times."""

        def receive(data: bytes, info: dict[str, int]) -> None:
            self._note(stream, data)
            if not stream.is_repeated(info):
                take(data, info)

        # rclpy's types do not know that a callback may take the message's times too.
        with_times: Any = receive
        stream = _Stream(
            topic,
            copy.copy(qos),
            lambda qos: self._node.create_subscription(
                kind, topic, with_times, qos, event_callbacks=events, raw=True
            ),
            is_raw=True,
        )
        self._streams.append(stream)

    def warning(self) -> str:
        """Returns a sentence on messages that are being dropped; empty if none are."""
        recent = time.monotonic() - _SHOWN
        return " ".join(
            f"Messages are being dropped, at least {self.dropped[topic]} of {topic}: {sentence}."
            for topic, (when, sentence) in sorted(self._said.items())
            if when > recent
        )

    def _note(self, stream: _Stream, data: bytes) -> None:
        stream.largest = max(stream.largest, len(data))
        self._taken += len(data)
        if len(data) >= _LARGE:
            self._taken_large += len(data)

    def _drop(self, topic: str, count: int, sentence: str) -> None:
        self.dropped[topic] += count
        self._said[topic] = (time.monotonic(), sentence)

    def _look(self) -> None:
        memory = (_own_memory() - self.kept()) * 1e-6
        self._floor = min(memory, self._floor + _FLOOR_RISES * _PERIOD)
        if memory > self._floor + _BUDGET:
            self._shorten_heaviest()
        is_backlog = memory > self._floor + _SHARE and self._taken > _SHARE * 1e6
        self._looks += 1
        if self._looks % _LOOKS == 0 and (is_backlog or self._taken_large >= _LEFT):
            self._taken = self._taken_large = 0
            trim()

    def _shorten_heaviest(self) -> None:
        heaviest = max(self._streams, key=lambda stream: stream.weight)
        if heaviest.weight <= _SHARE:
            return
        count = heaviest.shorten(self._node)
        self.lost += count * heaviest.is_raw
        self._drop(
            heaviest.topic,
            count,
            f"what waited there took more than {_BUDGET:g} MB of this node's memory; send less, or "
            "smaller messages",
        )
        trim()


def _own_memory() -> int:
    """Returns the resident memory that this process shares with no other [bytes]."""
    resident, shared = map(int, Path("/proc/self/statm").read_text().split()[1:3])
    return (resident - shared) * os.sysconf("SC_PAGE_SIZE")
