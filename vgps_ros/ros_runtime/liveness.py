# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Whether a node is alive, by the liveliness of a topic that it publishes.

The middleware takes up to 20 s to notice that a process was killed, and a node that hangs stays in
the graph for ever. Liveliness, a quality of service, tells both within the lease.
"""

import copy
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.duration import Duration
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import LivelinessPolicy, QoSProfile

from vgps_ros.ros_runtime.qos import STREAM

LEASE = 3.0  # silence after which a node counts as killed or hung [s]


def lively(qos: QoSProfile) -> QoSProfile:
    """Returns a publisher's profile whose liveliness the middleware asserts within the lease."""
    profile = copy.copy(qos)
    profile.liveliness = LivelinessPolicy.AUTOMATIC
    profile.liveliness_lease_duration = Duration(seconds=LEASE)
    return profile


class Liveness:
    """Subscribes to a topic and follows whether its publisher is alive.

    Args:
        node: the node that looks.
        kind: the topic's type.
        topic: one whose publisher offers `lively`.
        take: called with each message.
        group: of the callbacks; None: the node's own.

    Attributes:
        is_alive: whether a publisher is there, and its process runs.
        losses: how often a publisher was lost: it was killed, hung, or ended.
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        topic: str,
        take: Callable[[Any], None] = lambda _: None,
        group: CallbackGroup | None = None,
    ):
        self.is_alive = False
        self.losses = 0
        node.create_subscription(
            kind,
            topic,
            take,
            lively(STREAM),
            callback_group=group,
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._note),
        )

    def _note(self, change: QoSLivelinessChangedInfo) -> None:
        self.is_alive = change.alive_count > 0
        self.losses += change.alive_count_change < 0 or change.not_alive_count_change > 0
