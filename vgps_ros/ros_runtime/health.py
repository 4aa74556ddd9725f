# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A node's diagnostics: its faults, its warnings, and what it is waiting for."""

import platform
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from operator import itemgetter

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.settings import Range, Setting
from vgps_ros.ros_runtime.parameters import check_given_parameters, declare, value
from vgps_ros.ros_runtime.qos import STREAM, is_lively
from vgps_ros.ros_runtime.runner import end_with
from vgps_ros.ros_runtime.services import SERVICE_INTROSPECTION, steady_timer

_PERIOD = 1.0  # between two diagnostics [s]
_DISCOVERY = 1.2  # in which a new node discovers the others [s]
_LOG_PERIOD = 10.0  # at least, between two equal lines in the log [s]

WAIT_TIMEOUT = Setting(
    "wait_timeout",
    10.0,
    Range(0.1, 86400.0),
    "time after which something still missing becomes an error on /diagnostics [s]",
)


class Health:
    """Publishes one DiagnosticStatus a second on /diagnostics, and a fault at once.

    A node says what it waits for once, in a log line; if it still waits after the parameter
    `wait_timeout`, it says so once more as an error, and as the status ERROR until it is there.

    Args:
        node: the node, which has declared all its other parameters.
        owns: topics that only one node of the graph may publish as `lively`. A node that finds
            another one at its start ends with a sentence.
        when_alone: called once it is clear that no other node publishes one of these topics.
    """

    def __init__(
        self,
        node: Node,
        *,
        owns: Sequence[str] = (),
        when_alone: Callable[[], object] = lambda: None,
    ):
        self._node = node
        declare(node, WAIT_TIMEOUT, may_change=True)
        declare(node, SERVICE_INTROSPECTION)
        check_given_parameters(node)
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", STREAM)
        self._faults: dict[str, tuple[bytes, str]] = {}  # level and sentence, by what it is about
        self._over: set[str] = set()  # faults that the next diagnostics no longer show
        self._said: dict[str, tuple[str, float]] = {}  # last line in the log, and when
        self._waiting: dict[str, float] = {}  # since when [s]
        self._late: set[str] = set()  # of these, since longer than wait_timeout
        self._values: dict[str, str] = {}
        self._owns = owns
        self._when_alone = when_alone
        steady_timer(node, _PERIOD, self._tick)
        self._discovery = steady_timer(node, _DISCOVERY, self._look_for_rivals)

    def wait_for(self, what: str) -> None:
        """Notes that the node waits for something, and says so once: 'Waiting for …'."""
        if what not in self._waiting:
            self._waiting[what] = time.monotonic()
            self._node.get_logger().info(f"Waiting for {what}.")

    def arrived(self, what: str) -> None:
        """Notes that the node no longer waits for it, since it came."""
        if self.is_late(what):
            self._node.get_logger().info(f"Here now: {what}.")
        self.stop_waiting(what)

    def is_late(self, what: str) -> bool:
        """Returns whether the node has waited for it longer than `wait_timeout`."""
        return what in self._late

    def stop_waiting(self, *whats: str) -> None:
        """Notes that the node no longer needs these."""
        for what in whats:
            self._waiting.pop(what, None)
            self._late.discard(what)

    def sentence_of(self, error: Exception) -> str:
        """Returns what an error says; of one that was not foreseen the traceback is in the log."""
        if isinstance(error, VgpsError):
            return str(error)
        self._node.get_logger().error("".join(traceback.format_exception(error)))
        return f"{type(error).__name__}: {error}"

    def report(self, about: str, *, error: str = "", warning: str = "") -> None:
        """Reports how one thing stands: its fault, else its warning, else that it is well.

        What is wrong is on /diagnostics until it is cleared, and in the log, but not often.
        """
        if not (error or warning):
            self.clear(about)
            return
        level = DiagnosticStatus.ERROR if error else DiagnosticStatus.WARN
        before = self._faults.get(about, (DiagnosticStatus.OK, ""))[0]
        self._faults[about] = (level, error or warning)
        self._over.discard(about)
        if before != level:
            self._log(about)
            self.publish()

    @contextmanager
    def judging(self, about: str, refusal: str) -> Iterator[None]:
        """Reports what the statements within refuse, after some words, or that all is well."""
        try:
            yield
        except InvalidInputError as error:
            self.report(about, error=f"{refusal}: {error}")
        else:
            self.clear(about)

    def clear(self, *abouts: str) -> None:
        """Reports that faults are over; each was on /diagnostics at once, however short it was."""
        self._over.update(about for about in abouts if about in self._faults)

    def set_value(self, key: str, value: object) -> None:
        """Shows a figure beside the status."""
        self._values[key] = str(value)

    def _log(self, about: str) -> None:
        """Logs a fault, unless the same line was logged a moment ago."""
        level, sentence = self._faults[about]
        said, when = self._said.get(about, ("", 0.0))
        if sentence == said and time.monotonic() - when < _LOG_PERIOD:
            return
        # On lines of their own: rclpy refuses two severities from one.
        if level == DiagnosticStatus.ERROR:
            self._node.get_logger().error(sentence)
        else:
            self._node.get_logger().warning(sentence)
        self._said[about] = (sentence, time.monotonic())

    def _look_for_rivals(self) -> None:
        """Ends the node if another one publishes a topic that this one owns."""
        self._discovery.cancel()
        # Topics that a namespace does not change.
        remappings = "".join(f" -r {t}:={t[1:]}" for t in self._owns if t.startswith("/"))
        for topic in map(self._node.resolve_topic_name, self._owns):
            own = sum(publisher.topic_name == topic for publisher in self._node.publishers)
            names = [
                f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
                for publisher in self._node.get_publishers_info_by_topic(topic)
                if is_lively(publisher.qos_profile)  # not a player, or who else publishes frames
            ]
            if len(names) > own:
                rivals = [name for name in names if name != self._node.get_fully_qualified_name()]
                end_with(
                    VgpsError(
                        f"{[*rivals, names[0]][0]} publishes {topic} already, which only one node "
                        "of a graph may do: end that one first, use another ROS_DOMAIN_ID, or give "
                        f"this one topics of its own (--ros-args -r __ns:=/NAME{remappings})."
                    )
                )
                return
        self._when_alone()

    def _tick(self) -> None:
        timeout = value(self._node, WAIT_TIMEOUT)
        for what, since in list(self._waiting.items()):
            if time.monotonic() - since > timeout and what not in self._late:
                self._late.add(what)
                self._node.get_logger().error(
                    f"Still waiting for {what} after {timeout:g} s; is it running?"
                )
        for about, (_, sentence) in list(self._faults.items()):
            if sentence != self._said[about][0]:
                self._log(about)
        for about in self._over:
            self._faults.pop(about, None)
        self._over = set()
        self.publish()

    def publish(self) -> None:
        """Publishes the worst level, and all sentences on what is wrong, the worst first."""
        well, said = DiagnosticStatus.OK, list(self._faults.values())
        for what in list(self._waiting):
            if what in self._late:
                sentence = f"Still waiting for {what}; is it running?"
                said.append((DiagnosticStatus.ERROR, sentence))
            else:
                said.append((well, f"Waiting for {what}."))
        said = sorted(said, key=itemgetter(0), reverse=True) or [(well, "Running.")]
        worst = said[0][0]
        status = DiagnosticStatus(
            level=worst,
            name=self._node.get_fully_qualified_name(),
            message=" ".join(words for level, words in said if level != well or worst == well),
            hardware_id=platform.node(),  # the computer that the node runs on
            values=[KeyValue(key=k, value=v) for k, v in sorted(self._values.items())],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
