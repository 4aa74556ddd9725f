# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `recorder`: every topic of the graph, also those that appear later, into an MCAP bag."""

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_parameter_events
from rclpy.task import Future
from rosbag2_interfaces.srv import IsPaused, Pause, Resume

from vgps_ros.bags import BagWriter
from vgps_ros.bags.writer import UnfinishedBagError
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Range
from vgps_ros.messages.names import message_type
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import TopicFilter, declare_settings
from vgps_ros.ros_runtime.qos import CALLS
from vgps_ros.ros_runtime.runner import Runnable
from vgps_ros.ros_runtime.services import steady_timer
from vgps_ros.storage.software import environment

_DISCOVERY_PERIOD = 0.2  # between two looks for new topics [s]
_ATTACHMENT_PERIOD = 0.5  # between two looks for changed parameters [s]
_TYPE_PERIOD = 5.0  # between two attempts to find a topic's type [s]
_ANSWER_TIMEOUT = 5.0  # after which a node is asked for its parameters again [s]
_DEPTH = 10_000  # messages of a topic that may wait to be taken
_MOST_NODES = 200  # whose parameters are kept
_LONGEST = 100_000  # value of a parameter that is kept, as Python writes it
_MOST_TOPICS = 500  # of a bag: each takes memory, also where nothing comes
_WEAKER = (
    "Does not record all of {}: a publisher came later that offers a weaker quality of service; "
    "start it before the recorder."
)


@dataclass(frozen=True)
class _RecorderSettings:
    """Settings of the recorder. Their descriptions are what users read."""

    output: Annotated[str, "folder of the bag, which must not exist; empty: bag-DATE-TIME here"] = (
        ""
    )
    include: Annotated[tuple[str, ...], "regular expressions of topics to record"] = (".*",)
    exclude: Annotated[tuple[str, ...], "regular expressions of topics to leave out"] = ("^$",)
    services: Annotated[bool, "whether to record the events of services that publish them"] = False
    actions: Annotated[bool, "whether to record status and feedback of actions"] = False
    compression: Annotated[
        Literal["none", "lz4", "zstd"], "of the bag's chunks; zstd is smallest"
    ] = "none"
    max_file_size: Annotated[
        float, Range(0.0), "begin a new file beyond this size [MB]; 0: never"
    ] = 0.0
    max_file_duration: Annotated[
        float, Range(0.0), "begin a new file after this time [s]; 0: never"
    ] = 0.0
    cache_size: Annotated[
        float,
        Range(1.0, 1e5),
        "messages that may wait in memory for a slow disk; more than these are lost [MB]",
    ] = 100.0
    start_paused: Annotated[bool, "whether to wait for ~/resume before recording"] = False


class Recorder(Node):
    """Subscribes to every topic and writes the serialized messages as they arrive."""

    def __init__(self) -> None:
        super().__init__("recorder")
        settings = declare_settings(self, _RecorderSettings())
        self._with_services, self._with_actions = settings.services, settings.actions
        self._filter = TopicFilter(settings.include, settings.exclude)
        self._cache_size = settings.cache_size
        self._paused = settings.start_paused
        self._health = Health(self)
        self._passed_over: dict[str, float] = {}  # topics of unknown type, and when to try again
        self._lost = 0  # messages that had no place to wait for the disk, at the last report
        self._missed: Counter[str] = Counter()  # messages that came faster than they were taken
        self._missed_before = 0
        self._writer = BagWriter(
            Path(settings.output or f"bag-{datetime.now():%Y%m%d-%H%M%S}"),
            compression=settings.compression,
            max_file_size=round(settings.max_file_size * 1e6),
            max_file_duration=round(settings.max_file_duration * 1e9),
            max_backlog=round(settings.cache_size * 1e6),
        )
        self._wall_clock = Clock(clock_type=ClockType.SYSTEM_TIME)
        self._writer.attach("environment.yaml", environment(), self._wall_clock.now().nanoseconds)
        self._collector = _ParameterCollector(self)
        for kind, name, answer in (  # as `ros2 bag record` has them
            (Pause, "pause", partial(self._hold, True)),
            (Resume, "resume", partial(self._hold, False)),
            (IsPaused, "is_paused", self._tell_paused),
        ):
            self.create_service(kind, f"~/{name}", answer, qos_profile=CALLS)
        steady_timer(self, _DISCOVERY_PERIOD, self._discover)
        steady_timer(self, _ATTACHMENT_PERIOD, self._save)
        self.get_logger().info(f"Recording to {self._writer.path}.")

    def close(self) -> None:
        """Completes the bag, as far as the disk takes it."""
        self._save()
        try:
            self._writer.close()
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
            if not self._may_record(topic) or topic in self._writer.topics:
                continue
            if time.monotonic() < self._passed_over.get(topic, 0.0):
                continue
            is_full = len(self._writer.topics) >= _MOST_TOPICS
            sentence = f"Does not record {topic}, since {_MOST_TOPICS} topics are recorded already."
            self._health.report("topics", warning=sentence if is_full else "")
            if not is_full and (publishers := self.get_publishers_info_by_topic(topic)):
                self._record(topic, kinds[0], publishers)
        self._collector.look()
        self._report()

    def _may_record(self, topic: str) -> bool:
        """Returns whether a topic is wanted; those of services and actions on request alone."""
        if not self._filter.wants(topic):
            return False
        if "/_action/" in topic:
            return self._with_actions
        if topic.endswith("/_service_event"):
            return self._with_services
        return not any(part.startswith("_") for part in topic.split("/"))

    def _report(self) -> None:
        writer, health = self._writer, self._health
        health.set_value("messages", writer.message_count)
        missed = self._missed.total()
        health.set_value("messages_lost", writer.lost + missed)
        health.set_value("backlog_mb", round(writer.backlog * 1e-6, 1))
        health.set_value("topics", len(writer.topics))
        health.set_value("paused", self._paused)
        health.report("disk", error=writer.fault)
        cache = f"{self._cache_size:g} MB that may wait for the disk (cache_size)"
        full = f"Messages are being lost: the {cache} are full."
        slow = f"Over half of the {cache} are full: the disk is slower than the input."
        health.report(
            "cache",
            error=full if writer.lost > self._lost else "",
            warning=slow if writer.backlog * 1e-6 > 0.5 * self._cache_size else "",
        )
        fast = (
            f"Messages are being lost: {', '.join(sorted(self._missed))} came faster than the "
            f"recorder takes them, {missed} messages in all; leave topics out (exclude), or give "
            "it more of the processor."
        )
        health.report("pace", error=fast if missed > self._missed_before else "")
        self._lost, self._missed_before = writer.lost, missed

    def _record(self, topic: str, kind: str, publishers: Sequence[Any]) -> None:
        offered = [profile_in_bag(info.qos_profile) for info in publishers]
        try:
            kind_class = message_type(kind)
            self._writer.add_topic(topic, kind, str(publishers[0].topic_type_hash), offered)
        except InvalidInputError as error:
            self._passed_over[topic] = time.monotonic() + _TYPE_PERIOD
            self._health.report(topic, warning=f"Does not record {topic}: {error}")
            return
        self._health.clear(topic)
        # Each event costs processor time while nothing comes, so the other defaults are left out.
        events = SubscriptionEventCallbacks(
            message_lost=partial(self._count_missed, topic),
            incompatible_qos=lambda _: self._health.report(topic, warning=_WEAKER.format(topic)),
            use_default_callbacks=False,
        )
        qos = _strongest_profile(offered)
        # rclpy's types do not know that a callback may take the message's times too.
        write: Any = partial(self._write, topic)
        self.create_subscription(kind_class, topic, write, qos, event_callbacks=events, raw=True)

    def _count_missed(self, topic: str, lost: QoSMessageLostInfo) -> None:
        if not self._paused:
            self._missed[topic] += lost.total_count_change

    def _write(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        if not self._paused:
            self._writer.write(topic, info["received_timestamp"], data)

    def _save(self) -> None:
        if self._collector.is_changed:
            stamp = self._wall_clock.now().nanoseconds
            self._writer.attach("parameters.yaml", self._collector.text(), stamp)

    def _hold(self, paused: bool, _: object, response: Any) -> Any:
        if paused != self._paused:
            self._paused = paused
            self.get_logger().info("Recording pauses." if paused else "Recording goes on.")
        return response

    def _tell_paused(self, _: object, response: IsPaused.Response) -> IsPaused.Response:
        response.paused = self._paused
        return response


def profile_in_bag(profile: QoSProfile) -> dict[str, Any]:
    """Returns a profile as `metadata.yaml` has it, in version 9."""
    return {
        "history": profile.history.name.lower(),
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
        "deadline": _time(profile.deadline),
        "lifespan": _time(profile.lifespan),
        "liveliness": profile.liveliness.name.lower(),
        "liveliness_lease_duration": _time(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def _strongest_profile(offered: Sequence[dict[str, Any]]) -> QoSProfile:
    """Returns the strongest profile that all publishers of a topic offer, for a subscription."""
    latched = all(profile["durability"] == "transient_local" for profile in offered)
    reliable = all(profile["reliability"] == "reliable" for profile in offered)
    return QoSProfile(
        depth=_DEPTH,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


def _time(duration: Duration) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration.nanoseconds, 10**9)
    return {"sec": seconds, "nsec": nanoseconds}


class _ParameterCollector:
    """Asks each node once, and follows what changes; a node that has left keeps its entry.

    Attributes:
        is_changed: whether something is new since the last `text`.
    """

    def __init__(self, node: Node):
        self.is_changed = False
        self._node = node
        self._values: dict[str, dict[str, Any]] = {}
        self._asked: dict[str, float] = {}  # nodes, and when, by the steady clock [s]
        qos = qos_profile_parameter_events
        node.create_subscription(ParameterEvent, "/parameter_events", self._follow, qos)

    def look(self) -> None:
        """Asks nodes that are new; call it now and then."""
        names = {
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
        }
        # One that comes back is asked again, and one whose answer is late: it may have been lost.
        late = time.monotonic() - _ANSWER_TIMEOUT
        self._asked = {
            name: when
            for name, when in self._asked.items()
            if name in names and (name in self._values or when > late)
        }
        new = sorted(names - self._asked.keys())
        services = {name for name, _ in self._node.get_service_names_and_types()} if new else set()
        for name in new:
            has_place = len(self._asked.keys() | self._values.keys()) < _MOST_NODES
            if has_place and f"{name}/get_parameters" in services:
                self._asked[name] = time.monotonic()
                client = self._node.create_client(ListParameters, f"{name}/list_parameters")
                future = client.call_async(ListParameters.Request())
                future.add_done_callback(partial(self._take_names, name, client))

    def text(self) -> str:
        """Returns what is known as YAML that `--params-file` takes."""
        self.is_changed = False
        return yaml.safe_dump(
            {name: {"ros__parameters": values} for name, values in sorted(self._values.items())}
        )

    def _take_names(self, node: str, client: Client, future: Future) -> None:
        self._node.destroy_client(client)
        names = future.result().result.names
        values = self._node.create_client(GetParameters, f"{node}/get_parameters")
        answer = values.call_async(GetParameters.Request(names=names))
        answer.add_done_callback(partial(self._take_values, node, list(names), values))

    def _take_values(self, node: str, names: list[str], client: Client, future: Future) -> None:
        self._node.destroy_client(client)
        # A node that has parameters undeclared meanwhile answers with fewer values.
        for name, value in zip(names, future.result().values, strict=False):
            self._set(node, name, value)

    def _follow(self, event: ParameterEvent) -> None:
        if event.node in self._values:
            for parameter in (*event.new_parameters, *event.changed_parameters):
                self._set(event.node, parameter.name, parameter.value)

    def _set(self, node: str, name: str, message: Any) -> None:
        try:
            value = parameter_value_to_python(message)
        except RuntimeError:  # of a type that does not exist
            return
        value = value.tolist() if hasattr(value, "tolist") else value
        if len(repr(value)) > _LONGEST:
            return
        known = self._values.setdefault(node, {})
        if name not in known or known[name] != value:
            known[name] = value
            self.is_changed = True


NODE = Runnable(Recorder, close=Recorder.close)
