# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The other nodes of the graph, as /diagnostics shows them: there, silent, or one too many.

The middleware takes up to 20 s to notice that a process was killed, and never notices that one
hangs. A node that is well publishes its diagnostics each second, so silence tells both.
"""

import os
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.settings import Setting
from vgps_ros.messages.names import OWNS
from vgps_ros.ros_runtime.ending import end_with
from vgps_ros.ros_runtime.inbox import Inbox
from vgps_ros.ros_runtime.parameters import declare
from vgps_ros.ros_runtime.qos import SIGNS_OF_LIFE

HARDWARE_ID = "vgps_ros"  # marks the diagnostics of this project's nodes
INSTANCE = "instance"  # key of the value that tells one run of a node from the next
_LARGEST = 2**18  # of a message on /diagnostics [bytes]
_LAST_WORDS = 1.5  # after what a node said last, another run of it may be heard instead [s]
_GRACE = 1.0  # in which, once this process goes on, every node at work is heard again [s]
TRAINING = "training"  # key of the value that tells how far a training is; empty: there is none

PEER_TIMEOUT = Setting(
    "peer_timeout",
    3.0,
    "silence on /diagnostics after which another node counts as killed or hung [s]",
    minimum=2.5,
    maximum=3600.0,
)


@dataclass
class _Peer:
    instance: str
    heard: float  # [s], by the steady clock
    values: dict[str, str]
    silent: bool = False


class Peers:
    """Follows the other nodes of this project.

    A node that ends properly leaves the graph and is forgotten; one that is silent but still
    there was killed, or hangs.

    Args:
        node: the node that looks.
        inbox: its subscriptions.
        owns: topics that only one node of the graph may publish.

    Attributes:
        instance: identifies this run of the node; a later one is greater.
    """

    def __init__(self, node: Node, inbox: Inbox, owns: Sequence[str] = ()):
        self._node = node
        self._name = node.get_fully_qualified_name()
        self._timeout = declare(node, PEER_TIMEOUT)
        self.owns = [node.resolve_topic_name(topic) for topic in owns]
        # Topics that a namespace does not change.
        self._remappings = "".join(f" -r {t}:={t[1:]}" for t in owns if t.startswith("/"))
        self.instance = f"{time.time_ns()}-{socket.gethostname()}-{os.getpid()}"
        self._peers: dict[str, _Peer] = {}
        self._looked = time.monotonic()
        inbox.subscribe(
            DiagnosticArray, "/diagnostics", self._take, SIGNS_OF_LIFE, largest=_LARGEST
        )

    def instance_of(self, name: str) -> str:
        """Returns what identifies the latest run of a node; empty if it was never heard."""
        peer = self._peers.get(name)
        return peer.instance if peer else ""

    def is_silent(self, name: str) -> bool:
        """Returns whether a node was heard before, but not during the last `peer_timeout`."""
        peer = self._peers.get(name)
        return peer is not None and peer.silent

    def show(self, key: str, name: str = "") -> bool:
        """Returns whether a node has a value for this key; any node where no name is given."""
        peers = [peer for own, peer in self._peers.items() if name in ("", own)]
        return any(peer.values.get(key) and not peer.silent for peer in peers)

    def look(self) -> Sequence[str]:
        """Returns the names of those that are silent; to be called at least once a second."""
        now = time.monotonic()
        asleep, self._looked = now - self._looked, now
        for name, peer in list(self._peers.items()):
            # If this process itself was stopped, it heard nobody. If only the middleware held it up
            # for a second or two, since a stopped node holds a lock, that node is not excused.
            if asleep > 0.5 * self._timeout:
                peer.heard = max(peer.heard, now - self._timeout + _GRACE)
            if now - peer.heard <= self._timeout:
                continue
            if not peer.silent and not self._is_there(name):
                del self._peers[name]
            elif not peer.silent:
                peer.silent = True
                self._node.get_logger().warning(self._sentence(name))
        return [self._sentence(name) for name, peer in self._peers.items() if peer.silent]

    def _sentence(self, name: str) -> str:
        return f"{name} has been silent for over {self._timeout:g} s: it was killed, or it hangs."

    def _take(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {value.key: value.value for value in status.values}
            instance = values.get(INSTANCE, "")
            if status.hardware_id == HARDWARE_ID and instance not in ("", self.instance):
                self._hear(status, instance, values)

    def _hear(self, status: DiagnosticStatus, instance: str, values: dict[str, str]) -> None:
        theirs = values.get(OWNS, "").split()
        for topic in self.owns:
            if topic in theirs and instance < self.instance:
                self._refuse(status.name, instance, topic)
        if status.name == self._name:
            return
        peer, now = self._peers.get(status.name), time.monotonic()
        if peer and peer.silent:
            self._node.get_logger().info(f"{status.name} is heard again.")
        # The last messages of a run must not be taken for the next run's, nor those of a second
        # node, which is about to be refused, for the first node's.
        if not peer or instance == peer.instance or now - peer.heard > _LAST_WORDS:
            self._peers[status.name] = _Peer(instance, now, values)

    def _refuse(self, name: str, instance: str, topic: str) -> None:
        """Ends this node if the other one does publish a topic that this one owns."""
        publishers = self._node.get_publishers_info_by_topic(topic)
        names = [_full_name(p.node_namespace, p.node_name) for p in publishers]
        if names.count(name) > (name == self._name):
            process = instance.rpartition("-")[2]
            sentence = (
                f"{name} (process {process}) publishes {topic} already, which only one node of a "
                "graph may do: end that one first, use another ROS_DOMAIN_ID, or give this one "
                f"topics of its own (--ros-args -r __ns:=/NAME{self._remappings})."
            )
            end_with(VgpsError(sentence))

    def _is_there(self, name: str) -> bool:
        found = self._node.get_node_names_and_namespaces()
        return any(_full_name(namespace, own) == name for own, namespace in found)


def _full_name(namespace: str, name: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"
