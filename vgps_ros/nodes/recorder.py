"""Node `recorder`: every topic of the graph, also those that appear later, into an MCAP bag."""

import re
from collections.abc import Callable, Sequence
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

from vgps_ros.bags import BagWriter
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Setting
from vgps_ros.nodes.health import Health
from vgps_ros.nodes.parameters import declare
from vgps_ros.nodes.runner import run

OUTPUT = Setting("output", "", "folder of the bag, which must not exist; empty: bag-DATE-TIME here")
INCLUDE = Setting("include", (".*",), "regular expressions of topics to record")
EXCLUDE = Setting("exclude", ("^$",), "regular expressions of topics to leave out")

_DISCOVERY_PERIOD = 0.5  # between two looks for new topics [s]
_FLUSH_PERIOD = 1.0  # what a killed recorder loses at most [s]
_DEPTH = 1000  # messages of a topic that may wait to be written


class Recorder(Node):
    """Subscribes to the serialized messages of what is published, and writes them as they are."""

    def __init__(self) -> None:
        super().__init__("recorder")
        output = declare(self, OUTPUT, read_only=True)
        self._include = _patterns(declare(self, INCLUDE, read_only=True))
        self._exclude = _patterns(declare(self, EXCLUDE, read_only=True))
        self._health = Health(self)
        self._passed_over: set[str] = set()
        self._writer = BagWriter(Path(output or f"bag-{datetime.now():%Y%m%d-%H%M%S}"))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_DISCOVERY_PERIOD, self._discover, clock=steady)
        self.create_timer(_FLUSH_PERIOD, self._writer.flush, clock=steady)
        self.get_logger().info(f"Recording to {self._writer.path}.")

    def destroy_node(self) -> None:
        """Completes the bag."""
        self._writer.close()
        count, topics = self._writer.message_count, len(self._writer.topics)
        print(f"Recorded {count} messages of {topics} topics to {self._writer.path}.", flush=True)
        super().destroy_node()

    def _discover(self) -> None:
        for topic, kinds in self.get_topic_names_and_types():
            if topic not in self._writer.topics and topic not in self._passed_over:
                publishers = self.get_publishers_info_by_topic(topic)
                if publishers and self._is_wanted(topic):
                    self._record(topic, kinds[0], publishers)
        self._health.set_value("messages", self._writer.message_count)
        self._health.set_value("topics", len(self._writer.topics))

    def _is_wanted(self, topic: str) -> bool:
        if any(part.startswith("_") for part in topic.split("/")):
            return False  # hidden: the insides of actions
        included = any(pattern.search(topic) for pattern in self._include)
        return included and not any(pattern.search(topic) for pattern in self._exclude)

    def _record(self, topic: str, kind: str, publishers: Sequence[TopicEndpointInfo]) -> None:
        try:
            message_type = _import(kind)
            self._writer.add_topic(
                topic,
                kind,
                str(publishers[0].topic_type_hash),
                [_bag_qos(info.qos_profile) for info in publishers],
            )
        except (InvalidInputError, ImportError, AttributeError) as error:
            self._passed_over.add(topic)
            self.get_logger().warning(f"Does not record {topic}: {error}")
            return
        self.create_subscription(
            message_type, topic, self._write_to(topic), _matching_qos(publishers), raw=True
        )

    def _write_to(self, topic: str) -> Callable[[bytes], None]:
        clock = Clock(clock_type=ClockType.SYSTEM_TIME)

        def write(data: bytes) -> None:
            self._writer.write(topic, clock.now().nanoseconds, data)

        return write


def _patterns(expressions: Sequence[str]) -> list[re.Pattern[str]]:
    try:
        return [re.compile(expression) for expression in expressions]
    except re.error as error:
        raise InvalidInputError(
            f"include and exclude are {list(expressions)}, but each must be a regular expression: "
            f"{error}."
        ) from error


def _import(kind: str) -> Any:
    package, _, name = kind.partition("/msg/")
    return getattr(import_module(f"{package}.msg"), name)


def _matching_qos(publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """The strongest profile that every publisher of the topic offers."""
    offered = [info.qos_profile for info in publishers]
    latched = all(q.durability == DurabilityPolicy.TRANSIENT_LOCAL for q in offered)
    reliable = all(q.reliability == ReliabilityPolicy.RELIABLE for q in offered)
    return QoSProfile(
        depth=_DEPTH,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


def _bag_qos(qos: QoSProfile) -> Qos:
    """The profile as a bag's metadata has it; both count the policies alike."""

    def time(duration: Any) -> QosTime:
        seconds, nanoseconds = divmod(duration.nanoseconds, 10**9)
        return QosTime(seconds, nanoseconds)

    return Qos(
        QosHistory(int(qos.history)),
        qos.depth,
        QosReliability(int(qos.reliability)),
        QosDurability(int(qos.durability)),
        time(qos.deadline),
        time(qos.lifespan),
        QosLiveliness(int(qos.liveliness)),
        time(qos.liveliness_lease_duration),
        qos.avoid_ros_namespace_conventions,
    )


def main() -> None:
    """Runs the node."""
    run(Recorder)
