# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The quality-of-service profiles of the graph, by name, and who is alive by them.

Profiles are reliable, if not said otherwise. The middleware takes up to 20 s to notice that a
process was killed, and a node that hangs stays in the graph for ever. Liveliness, a quality of
service of the topics that a node publishes, tells both within a lease.
"""

import copy
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.duration import Duration
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

# Data that flows: states, commands, progress. Deep, so that a listener on a loaded machine may fall
# behind for a moment and still gets every message.
STREAM = QoSProfile(depth=1000)

# The other end of a stream of states, for a controller: it acts on the newest, never on a backlog.
NEWEST = QoSProfile(depth=1)

# The same for the sensors of a real robot, to which REP 2003 has nodes listen with best effort.
NEWEST_OF_SENSORS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

# What a person or a planner commands: the newest ones matter, whatever their sender guarantees.
COMMANDED = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)

# The requests and responses of services and actions. As many calls may wait at once; of more the
# middleware drops the oldest, without a word to who waits for their answer.
CALLS = QoSProfile(depth=100)

# The last values matter, also to nodes that start later: the distributions of several trajectories.
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)

# The publisher's end of a latched topic of which only the newest value matters: policy, robot.
LATEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

LEASE = 3.0  # silence after which a node counts as killed or hung [s]


def lively(qos: QoSProfile) -> QoSProfile:
    """Returns a publisher's profile whose liveliness the middleware asserts within the lease."""
    profile = copy.copy(qos)
    profile.liveliness = LivelinessPolicy.AUTOMATIC
    profile.liveliness_lease_duration = Duration(seconds=LEASE)
    return profile


def is_lively(qos: QoSProfile) -> bool:
    """Returns whether a publisher's profile is one of `lively`."""
    return qos.liveliness_lease_duration == Duration(seconds=LEASE)


class Liveness:
    """Subscribes to a topic whose publisher offers `lively`, and follows whether it is alive.

    Attributes:
        is_alive: whether a publisher is there, and its process runs.
        losses: how often a publisher was lost: it was killed, hung, or ended.
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        topic: str,
        *,
        group: CallbackGroup | None = None,
    ):
        self.is_alive = False
        self.losses = 0
        node.create_subscription(
            kind,
            topic,
            lambda _: None,
            lively(STREAM),
            callback_group=group,
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._note),
        )

    def _note(self, change: QoSLivelinessChangedInfo) -> None:
        self.is_alive = change.alive_count > 0
        self.losses += change.alive_count_change < 0 or change.not_alive_count_change > 0
