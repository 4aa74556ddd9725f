# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Publishers for the recorded messages of a bag: raw CDR, with the recorded quality of service."""

import json
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher

from vgps_ros.bags.reader import BagMessage
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.names import message_type
from vgps_ros.ros_runtime.bag_qos import replaying

_BURST = 500  # messages of a topic ...
_BURST_TIME = 0.05  # ... that make a burst if they are published within this time [s]
_BURST_PAUSE = 0.2  # longest wait for acknowledgements after a burst [s]
_POLL_PERIOD = 0.001  # between two looks for acknowledgements [s]


class ReplayPublishers:
    """Publishes the messages of several topics, each as it was recorded."""

    def __init__(self, node: Node):
        self._node = node
        self._outlets: dict[str, _Outlet] = {}
        self.counts: Counter[str] = Counter()

    def add(
        self, topic: str, kind: str, type_hash: str = "", offered: Sequence[dict[str, Any]] = ()
    ) -> None:
        """Adds a topic.

        Args:
            topic: its full name.
            kind: its type, such as `sensor_msgs/msg/JointState`.
            type_hash: RIHS01 hash of the recorded type, or nothing.
            offered: profiles that its publishers offered, as a bag's metadata has them.

        Raises:
            InvalidInputError: the type is not installed, or has other fields than it had.
        """
        publisher = self._node.create_publisher(
            _checked_type(kind, type_hash), topic, replaying(offered)
        )
        self._outlets[topic] = _Outlet(publisher)

    def publish(self, message: BagMessage) -> None:
        """Publishes a message of a topic that was added."""
        try:
            self._outlets[message.topic].publish(message.data)
        except RuntimeError:
            # INT and TERM close the context, maybe in the middle of a call.
            if self._node.context.ok():
                raise
            return
        self.counts[message.topic] += 1

    def wait_for_acknowledgements(self, timeout: float) -> bool:
        """Waits until subscribers have all messages; returns whether they have.

        INT and TERM end the wait, and so does the timeout [s]. A subscriber acknowledges the last
        messages when the middleware asks it the next time, which may take seconds.
        """
        is_open, outlets = self._node.context.ok, self._outlets.values()
        try:
            return _poll(
                lambda: not is_open() or all(outlet.is_acknowledged() for outlet in outlets),
                timeout,
                20 * _POLL_PERIOD,
            )
        except RuntimeError:
            if is_open():
                raise
            return True


class _Outlet:
    """One topic's publisher, with a brake.

    The middleware keeps so many messages until they are acknowledged, then drops the oldest. A
    burst, such as a replay that catches up, waits in between so that none is dropped.
    """

    def __init__(self, publisher: Publisher):
        self._publisher = publisher
        self._count = 0  # since the last look at the time
        self._since = 0.0

    def publish(self, data: bytes) -> None:
        self._publisher.publish(data)
        self._count += 1
        if self._count == _BURST:
            if time.monotonic() - self._since < _BURST_TIME:
                _poll(self.is_acknowledged, _BURST_PAUSE, _POLL_PERIOD)
            self._count, self._since = 0, time.monotonic()

    def is_acknowledged(self) -> bool:
        # Waiting in rclpy would hold up all other threads.
        return self._publisher.wait_for_all_acked(Duration(nanoseconds=0))


def _poll(condition: Callable[[], bool], timeout: float, period: float) -> bool:
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(period)
    return True


def _checked_type(kind: str, type_hash: str) -> type:
    """The installed type, if it is the recorded one: raw messages of another would be misread."""
    found = message_type(kind)
    package, _, name = kind.partition("/msg/")
    file = Path(get_package_share_directory(package), "msg", f"{name}.json")
    hashes = json.loads(file.read_text())["type_hashes"] if file.is_file() else []
    installed = {entry["type_name"]: entry["hash_string"] for entry in hashes}.get(kind)
    if type_hash and installed and installed != type_hash:
        raise InvalidInputError(
            f"the type {kind} was recorded with other fields than the installed one has; source "
            "the package's version of the recording."
        )
    return found
