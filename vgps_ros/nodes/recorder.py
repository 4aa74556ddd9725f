"""Node `recorder`: every topic of the graph, also those that appear later, into an MCAP bag."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import (
    QoSMessageLostInfo,
    QoSRequestedIncompatibleQoSInfo,
    SubscriptionEventCallbacks,
)
from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_srvs.srv import Trigger

from vgps_ros.bags import BagWriter
from vgps_ros.bags.software import environment
from vgps_ros.bags.storage_writer import COMPRESSIONS
from vgps_ros.bags.topic_filter import TopicFilter
from vgps_ros.bags.writer import UnfinishedBagError
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Setting
from vgps_ros.messages.types import message_type
from vgps_ros.ros_runtime.bag_qos import recording, to_bag
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameter_collector import ParameterCollector
from vgps_ros.ros_runtime.parameters import declare
from vgps_ros.ros_runtime.responses import answered
from vgps_ros.ros_runtime.runner import run
from vgps_ros.ros_runtime.steady_timer import steady_timer

OUTPUT = Setting("output", "", "folder of the bag, which must not exist; empty: bag-DATE-TIME here")
INCLUDE = Setting("include", (".*",), "regular expressions of topics to record")
EXCLUDE = Setting("exclude", ("^$",), "regular expressions of topics to leave out")
COMPRESSION = Setting(
    "compression", "none", "of the bag's chunks; zstd is smallest", choices=tuple(COMPRESSIONS)
)
MAX_FILE_SIZE = Setting(
    "max_file_size", 0.0, "begin a new file beyond this size [MB]; 0: never", minimum=0.0
)
MAX_FILE_DURATION = Setting(
    "max_file_duration", 0.0, "begin a new file after this time [s]; 0: never", minimum=0.0
)
CACHE_SIZE = Setting(
    "cache_size",
    100.0,
    "messages that may wait in memory for a slow or full disk; more than these are lost [MB]",
    minimum=1.0,
    maximum=1e5,
)
MIN_SPACE = Setting(
    "min_space",
    16.0,
    "space that is left free on the disk, so that the bag can be completed there [MB]",
    minimum=0.0,
    maximum=1e7,
)
START_PAUSED = Setting("start_paused", False, "whether to wait for ~/resume before recording")

_DISCOVERY_PERIOD = 0.2  # between two looks for new topics [s]
_FLUSH_PERIOD = 0.5  # a killed recorder loses the messages of this time at most [s]
_TYPE_PERIOD = 5.0  # between two attempts to find a topic's type [s]


class Recorder(Node):
    """Subscribes to every topic and writes the serialized messages as they arrive."""

    def __init__(self) -> None:
        super().__init__("recorder")
        output = declare(self, OUTPUT, read_only=True)
        include, exclude = (declare(self, s, read_only=True) for s in (INCLUDE, EXCLUDE))
        self._filter = TopicFilter(include, exclude)
        compression = declare(self, COMPRESSION, read_only=True)
        megabytes = declare(self, MAX_FILE_SIZE, read_only=True)
        seconds = declare(self, MAX_FILE_DURATION, read_only=True)
        self._cache_size = declare(self, CACHE_SIZE, read_only=True)
        min_space = declare(self, MIN_SPACE, read_only=True)
        self._paused = declare(self, START_PAUSED, read_only=True)
        self._health = Health(self)
        self._passed_over: dict[str, float] = {}  # topics of unknown type, and when to try again
        self._lost = 0  # messages that had no place to wait for the disk, at the last report
        self._missed: Counter[str] = Counter()  # messages that came faster than they were taken
        self._missed_before = 0
        self._writer = BagWriter(
            Path(output or f"bag-{datetime.now():%Y%m%d-%H%M%S}"),
            compression=compression,
            max_file_size=round(megabytes * 1e6),
            max_file_duration=round(seconds * 1e9),
            max_backlog=round(self._cache_size * 1e6),
            min_space=round(min_space * 1e6),
        )
        self._wall_clock = Clock(clock_type=ClockType.SYSTEM_TIME)
        self._writer.attach("environment.yaml", environment(), self._wall_clock.now().nanoseconds)
        self._collector = ParameterCollector(self)
        self.create_service(Trigger, "~/pause", self._pause)
        self.create_service(Trigger, "~/resume", self._resume)
        steady_timer(self, _DISCOVERY_PERIOD, self._discover)
        steady_timer(self, _FLUSH_PERIOD, self._save)
        self.get_logger().info(f"Recording to {self._writer.path}.")

    def close(self, is_hurried: Callable[[], bool]) -> None:
        """Completes the bag, as far as the disk takes it."""
        self._save()
        try:
            self._writer.close(is_hurried)
        except UnfinishedBagError as error:
            self.get_logger().error(str(error))
        count, topics = self._writer.message_count, len(self._writer.topics)
        lost = self._writer.lost + self._missed.total()
        words = f" {lost} messages are lost." if lost else ""
        path = self._writer.path
        print(f"Recorded {count} messages of {topics} topics to {path}.{words}", flush=True)

    def _discover(self) -> None:
        found = self.get_topic_names_and_types()
        for topic in self._passed_over.keys() - dict(found).keys():
            del self._passed_over[topic]
            self._health.clear(topic)
        for topic, kinds in found:
            if topic in self._writer.topics or not self._is_wanted(topic):
                continue
            if time.monotonic() < self._passed_over.get(topic, 0.0):
                continue
            if publishers := self.get_publishers_info_by_topic(topic):
                self._record(topic, kinds[0], publishers)
        self._collector.look()
        self._report()

    def _report(self) -> None:
        writer, health = self._writer, self._health
        health.set_value("messages", writer.message_count)
        missed = self._missed.total()
        health.set_value("messages_lost", writer.lost + missed)
        health.set_value("backlog_mb", round(writer.disk.backlog * 1e-6, 1))
        health.set_value("topics", len(writer.topics))
        health.set_value("paused", self._paused)
        health.report("disk", error=writer.disk.fault.sentence if writer.disk.fault else "")
        cache = f"{self._cache_size:g} MB that may wait for the disk (cache_size)"
        full = f"Messages are being lost: the {cache} are full."
        slow = f"Of the {cache} over half are full; it takes less than what comes."
        health.report(
            "cache",
            error=full if writer.lost > self._lost else "",
            warning=slow if writer.disk.backlog * 1e-6 > 0.5 * self._cache_size else "",
        )
        fast = (
            f"Messages are being lost: {', '.join(sorted(self._missed))} came faster than the "
            f"recorder takes them, {missed} messages in all; leave topics out (exclude), or give "
            "it more of the processor."
        )
        health.report("pace", error=fast if missed > self._missed_before else "")
        self._lost, self._missed_before = writer.lost, missed

    def _is_wanted(self, topic: str) -> bool:
        hidden = any(part.startswith("_") for part in topic.split("/"))  # the insides of actions
        return not hidden and self._filter.wants(topic)

    def _record(self, topic: str, kind: str, publishers: Sequence[TopicEndpointInfo]) -> None:
        offered = [to_bag(info.qos_profile) for info in publishers]
        try:
            kind_class = message_type(kind)
            self._writer.add_topic(topic, kind, str(publishers[0].topic_type_hash), offered)
        except InvalidInputError as error:
            self._passed_over[topic] = time.monotonic() + _TYPE_PERIOD
            self._health.report(topic, warning=f"Does not record {topic}: {error}")
            return
        self._health.clear(topic)
        # rclpy's types do not know that a callback may take the message's times too.
        write: Any = self._write_to(topic)
        self.create_subscription(
            kind_class,
            topic,
            write,
            recording(offered),
            event_callbacks=self._watch(topic),
            raw=True,
        )

    def _watch(self, topic: str) -> SubscriptionEventCallbacks:
        """Returns callbacks for when the middleware delivers less than is published."""

        def count(lost: QoSMessageLostInfo) -> None:
            if not self._paused:
                self._missed[topic] += lost.total_count_change

        def warn(_: QoSRequestedIncompatibleQoSInfo) -> None:
            sentence = (
                f"Does not record all of {topic}: a publisher came later that offers a weaker "
                "quality of service; start it before the recorder."
            )
            self._health.report(topic, warning=sentence)

        # Each event costs processor time while nothing comes, so the other defaults are left out.
        return SubscriptionEventCallbacks(
            message_lost=count, incompatible_qos=warn, use_default_callbacks=False
        )

    def _write_to(self, topic: str) -> Callable[[bytes, dict[str, int]], None]:
        def write(data: bytes, info: dict[str, int]) -> None:
            if not self._paused:
                self._writer.write(topic, info["received_timestamp"], data)

        return write

    def _save(self) -> None:
        if self._collector.is_changed:
            stamp = self._wall_clock.now().nanoseconds
            self._writer.attach("parameters.yaml", self._collector.text(), stamp)
        self._writer.flush(wait=False)

    def _pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        was_paused, self._paused = self._paused, True
        return answered(response, not was_paused, "Recording pauses.", "It was paused already.")

    def _resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        was_paused, self._paused = self._paused, False
        return answered(response, was_paused, "Recording goes on.", "It was not paused.")


def main() -> int:
    """Runs the node; returns the exit code."""
    return run(Recorder, close=Recorder.close)
