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

# The sender's end of states and commands. Lock-step has one state under way, perhaps with a copy,
# and its answer, so 2 keeps it whole; 10 lets a listener ask again for what it missed.
STATES = QoSProfile(depth=10)

# What must not be lost: progress, diagnostics. Who wants all states listens with it, too: it may
# fall behind for a moment, on a loaded machine, at the cost of its own memory only.
STREAM = QoSProfile(depth=1000)

# The other end of a stream of states, for a controller: it acts on the newest, never on a backlog.
NEWEST = QoSProfile(depth=1)

# The same for the sensors of a real robot, to which REP 2003 has nodes listen with best effort. Of
# joint_states, each driver of some joints may have a message waiting.
NEWEST_OF_SENSORS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
PARTS_OF_SENSORS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)

# What a person or a planner commands: the newest ones matter, whatever their sender guarantees.
COMMANDED = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)

# The requests and responses of services and actions. As many calls may wait at once; of more the
# middleware drops the oldest, without a word to who waits for their answer.
CALLS = QoSProfile(depth=100)

# The last values matter, also to nodes that start later: the distributions of several trajectories.
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)

# The publisher's end of a latched topic of which only the newest value matters: policy, robot.
LATEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

_PROCESS = 12  # bytes of an endpoint's id that all of a process have in common

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
        losses: how often a publisher was lost: it was killed, hung, or ended.
    """

    def __init__(self, node: Node, kind: Any, topic: str, *, group: CallbackGroup | None = None):
        self.losses = 0
        self._is_alive = False
        self._node, self._topic = node, node.resolve_topic_name(topic)
        node.create_subscription(
            kind,
            topic,
            lambda _: None,
            lively(STREAM),
            callback_group=group,
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._note),
        )

    @property
    def is_alive(self) -> bool:
        """Whether a publisher is there, and its process runs.

        The middleware tells nothing of one in this process, which is known by how its id begins.
        """
        if self._is_alive:
            return True
        own = self._node.get_name(), self._node.get_namespace()
        here = {
            bytes(reader.endpoint_gid[:_PROCESS])
            for reader in self._node.get_subscriptions_info_by_topic(self._topic)
            if (reader.node_name, reader.node_namespace) == own
        }
        writers = self._node.get_publishers_info_by_topic(self._topic)
        return any(bytes(writer.endpoint_gid[:_PROCESS]) in here for writer in writers)

    def _note(self, change: QoSLivelinessChangedInfo) -> None:
        self._is_alive = change.alive_count > 0
        self.losses += change.alive_count_change < 0 or change.not_alive_count_change > 0
