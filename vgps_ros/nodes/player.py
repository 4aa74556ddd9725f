# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `player`: publishes a bag's messages again, byte for byte and at their times."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, takewhile
from pathlib import Path
from typing import Annotated, Any

from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbag2_interfaces.srv import (
    Burst,
    GetRate,
    IsPaused,
    Pause,
    Play,
    PlayNext,
    Resume,
    Seek,
    SetRate,
    Stop,
    TogglePaused,
)

from vgps_ros.bags.playback import (
    CLOCK_KIND,
    CLOCK_TOPIC,
    ClockTick,
    Playback,
    PlaybackSettings,
    with_clock,
)
from vgps_ros.bags.reader import BagMessage, BagReader
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.settings import Range
from vgps_ros.messages.conversions import nanoseconds
from vgps_ros.messages.names import installed_hash, message_type
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import TopicFilter, declare_settings
from vgps_ros.ros_runtime.qos import CALLS
from vgps_ros.ros_runtime.runner import Runnable
from vgps_ros.ros_runtime.services import steady_timer

_LOOK_PERIOD = 1.0  # between two values on /diagnostics [s]
_LOG_LOOKS = 5  # values for one line in the log
_ACKNOWLEDGEMENT_TIMEOUT = 5.0  # at the end [s]
_SENT_DEPTH = 10_000  # messages of a topic that may wait to be acknowledged
_LATCHED_DEPTH = 10  # messages of a latched topic that those who come later get


@dataclass(frozen=True)
class _PlayerSettings(PlaybackSettings):
    """Settings of the player. Their descriptions are what users read."""

    bag: Annotated[str, "folder of the bag; must be given"] = ""
    include: Annotated[tuple[str, ...], "regular expressions of topics to play"] = (".*",)
    exclude: Annotated[tuple[str, ...], "regular expressions of topics to leave out"] = ("^$",)
    clock_rate: Annotated[
        float,
        Range(0.0, 1e4),
        "publication rate of /clock, from the times of receipt [Hz of the wall clock]; 0: as "
        "recorded",
    ] = 0.0
    stay: Annotated[bool, "whether to wait for ~/play where the bag ends, or ~/stop ends it"] = (
        False
    )


class Player(Node):
    """Plays in a thread of its own; the node's services and diagnostics run beside it."""

    def __init__(self) -> None:
        super().__init__("player")
        self._settings = settings = declare_settings(self, _PlayerSettings())
        self._health = Health(self)
        if not settings.bag:
            raise InvalidInputError("bag is '', but it must name the folder of a bag.")
        self._bag = BagReader(Path(settings.bag))
        self._duration = self._bag.duration * 1e-9  # [s]
        self._replayed: dict[str, Publisher] = {}
        self._played: Counter[str] = Counter()
        self._is_closing = threading.Event()
        self._topics = self._add_topics(TopicFilter(settings.include, settings.exclude))
        self._prepare(self._settings)
        self._error: VgpsError | None = None
        self._looks = 0
        for kind, name, answer in (  # as `ros2 bag play` has them
            (Pause, "pause", partial(self._hold, lambda: True)),
            (Resume, "resume", partial(self._hold, lambda: False)),
            (TogglePaused, "toggle_paused", partial(self._hold, lambda: not self._playback.paused)),
            (IsPaused, "is_paused", partial(self._tell, "paused")),
            (GetRate, "get_rate", partial(self._tell, "rate")),
            (SetRate, "set_rate", self._set_rate),
            (PlayNext, "play_next", self._play_next),
            (Burst, "burst", self._burst),
            (Seek, "seek", self._seek),
            (Play, "play", self._play_again),
            (Stop, "stop", self._stop),
        ):
            self.create_service(kind, f"~/{name}", answer, qos_profile=CALLS)
        steady_timer(self, _LOOK_PERIOD, self._look)
        self._end = self.create_guard_condition(self._on_end)
        self.get_logger().info(
            f"Plays {len(self._topics)} topics of {settings.bag}, {self._duration:.1f} s long, "
            f"at rate {self._settings.rate:g}{', paused' * self._settings.start_paused}."
        )
        # Not here: a signal may still end this constructor, and a running thread would keep the
        # node to the end of the process, and others would take it for alive.
        self.create_guard_condition(self._thread.start).trigger()

    def close(self) -> None:
        """Ends the playback."""
        self._playback.stop()
        self._is_closing.set()
        if self._thread.ident:
            self._thread.join()
        self._bag.close()
        print(
            f"Played {self._played.total()} messages of {len(self._played)} topics of "
            f"{self._bag.path}, up to {self._playback.position:.2f} s.",
            flush=True,
        )

    def _add_topics(self, topic_filter: TopicFilter) -> list[str]:
        """Makes the publishers; returns the topics to read."""
        counts, hashes, qos = self._bag.counts, self._bag.type_hashes, self._bag.qos
        filled = {topic: kind for topic, kind in self._bag.topics.items() if counts[topic]}
        if not filled:
            raise InvalidInputError(f"'{self._bag.path}' has no messages to play.")
        left_out = [topic for topic in filled if not topic_filter.wants(topic)]
        if left_out:
            self.get_logger().warning(f"Leaves out {', '.join(sorted(left_out))}, by the patterns.")
        topics: list[str] = []
        for topic, kind in filled.items():
            if topic in left_out or (topic == CLOCK_TOPIC and self._settings.clock_rate):
                continue
            try:
                self._add(topic, kind, hashes[topic], qos[topic])
                topics.append(topic)
            except InvalidInputError as error:
                self.get_logger().warning(f"Does not play {topic}: {error}")
        if not topics:
            raise InvalidInputError(
                f"No topic of '{self._bag.path}' is left to play; it has "
                f"{', '.join(sorted(filled))}."
            )
        if self._settings.clock_rate:
            self._add(CLOCK_TOPIC, CLOCK_KIND)
        return topics

    def _add(
        self, topic: str, kind: str, type_hash: str = "", offered: Sequence[dict[str, Any]] = ()
    ) -> None:
        """Makes a publisher for a topic as the bag describes it."""
        found, profile = message_type(kind), _matching_profile(offered)
        if type_hash and type_hash != (installed_hash(kind) or type_hash):
            raise InvalidInputError(
                f"the type {kind} was recorded with other fields than the installed one has; "
                "source the package's version of the recording."
            )
        self._replayed[topic] = self.create_publisher(found, topic, profile)

    def _prepare(self, settings: PlaybackSettings, until: int = 2**63) -> None:
        """Prepares to play the bag, and the messages up to a time of receipt [ns]."""

        def read() -> Iterable[BagMessage]:
            messages = takewhile(lambda m: m.stamp <= until, self._bag.messages(self._topics))
            if not self._settings.clock_rate:
                return messages
            rate = self._settings.clock_rate
            return with_clock(messages, lambda: max(1, round(1e9 * self._playback.rate / rate)))

        self._is_stopped = False  # by ~/stop
        self._playback = Playback(read, self._publish, self._bag.start, settings)
        self._thread = threading.Thread(target=self._play, name="playback")

    # The playback's thread

    def _play(self) -> None:
        try:
            try:
                self._playback.run()
            finally:  # also of what comes before damage in the bag
                self._settle()
            if not (self._played or self._is_stopped or self._is_closing.is_set()):
                raise InvalidInputError(
                    f"start_offset is {self._settings.start_offset:g} s, but the bag is only "
                    f"{self._duration:.2f} s long."
                )
        except VgpsError as error:
            self._error = error
        except Exception as error:
            # A damaged bag fails in many ways, deep inside what reads it.
            self._error = InvalidInputError(
                f"Playing '{self._bag.path}' failed after {self._played.total()} "
                f"messages: {type(error).__name__}: {error}"
            )
        self._end.trigger()

    def _publish(self, message: BagMessage) -> None:
        self._replayed[message.topic].publish(message.data)
        self._played[message.topic] += 1

    def _settle(self) -> None:
        """Waits until the messages have arrived, a while at most, or the node ends.

        A subscriber acknowledges the last messages when the middleware asks it the next time, which
        may take seconds.
        """
        end, at_once = time.monotonic() + _ACKNOWLEDGEMENT_TIMEOUT, Duration()
        while not self._is_closing.wait(0.02):
            if all(p.wait_for_all_acked(at_once) for p in self._replayed.values()):
                return
            if time.monotonic() > end:
                self.get_logger().warning("Some subscriber has not acknowledged all messages.")
                return

    # The node's thread

    def _on_end(self) -> None:
        if self._error:
            raise self._error
        if not self._settings.stay:
            raise ExternalShutdownException
        self.get_logger().info("Played to the end; ~/play plays again.")

    def _look(self) -> None:
        self._show()
        self._looks += 1
        if self._looks % _LOG_LOOKS == 0 and not self._playback.paused:
            at, count = self._playback.position, self._played.total()
            self.get_logger().info(f"At {at:.1f} s of {self._duration:.1f} s, {count} messages.")

    def _show(self) -> None:
        self._health.set_value("position", f"{self._playback.position:.2f} s")
        self._health.set_value("rate", f"{self._playback.rate:g}")
        self._health.set_value("messages", self._played.total())
        self._health.set_value("paused", self._playback.paused)

    def _log(self, words: str) -> None:
        self._show()
        self.get_logger().info(f"{words}, at {self._playback.position:.2f} s.")

    # Services

    def _hold(self, is_held: Callable[[], bool], _: object, response: Any) -> Any:
        if is_held():
            self._playback.pause()
            self._log("Paused")
        else:
            self._playback.resume()
            self._log("Goes on")
        return response

    def _tell(self, name: str, _: object, response: Any) -> Any:
        setattr(response, name, getattr(self._playback, name))
        return response

    def _set_rate(self, request: SetRate.Request, response: SetRate.Response) -> SetRate.Response:
        try:
            self._playback.set_rate(request.rate)
        except InvalidInputError as error:
            self.get_logger().warning(str(error))
        else:
            response.success = True
            self._log(f"Plays at rate {request.rate:g}")
        return response

    def _play_next(self, _: object, response: PlayNext.Response) -> PlayNext.Response:
        response.success = self._playback.step() is not None
        return response

    def _burst(self, request: Burst.Request, response: Burst.Response) -> Burst.Response:
        whole = sum(self._bag.counts[topic] for topic in self._topics)  # a loop has no end
        steps = islice(iter(self._playback.step, None), min(request.num_messages or whole, whole))
        response.actually_burst = sum(1 for _ in steps)
        return response

    def _seek(self, request: Seek.Request, response: Seek.Response) -> Seek.Response:
        stamp = nanoseconds(request.time)
        position = max(0, stamp - self._bag.start)
        if position > self._bag.duration or self._playback.ended:
            return response
        self._playback.seek(position)
        if self._settings.clock_rate:  # also while it is paused
            self._publish(ClockTick.at(self._bag.start + position))
        response.success = True
        self._log("Seeks")
        return response

    def _play_again(self, request: Play.Request, response: Play.Response) -> Play.Response:
        """Plays a part of the bag; times of zero leave it whole."""
        offset = nanoseconds(request.start_offset)
        if self._thread.is_alive() or not (
            self._playback.ended and 0 <= offset <= self._bag.duration
        ):
            return response
        duration = nanoseconds(request.playback_duration)
        ends = [self._bag.start + offset + duration] * (duration > 0)
        ends += [nanoseconds(request.playback_until_timestamp)]
        settings = replace(self._settings, start_offset=offset * 1e-9, start_paused=False)
        self._prepare(settings, max(ends) if max(ends) > 0 else 2**63)
        self._thread.start()
        response.success = True
        return response

    def _stop(self, _: object, response: Stop.Response) -> Stop.Response:
        self._is_stopped = True
        self._playback.stop()
        return response


def _matching_profile(offered: Sequence[dict[str, Any]]) -> QoSProfile:
    """Returns a profile that matches whom any of the recorded publishers matched."""
    reliable = not offered or any(p["reliability"] != "best_effort" for p in offered)
    latched = any(p["durability"] == "transient_local" for p in offered)
    return QoSProfile(
        depth=_LATCHED_DEPTH if latched else _SENT_DEPTH,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


NODE = Runnable(Player, close=Player.close)
