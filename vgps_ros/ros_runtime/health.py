# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A node's diagnostics: its faults, its warnings, and what it is waiting for."""

import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import itemgetter

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.settings import Setting
from vgps_ros.messages.names import OWNS
from vgps_ros.ros_runtime import middleware
from vgps_ros.ros_runtime.given_parameters import check_given_parameters
from vgps_ros.ros_runtime.inbox import Inbox
from vgps_ros.ros_runtime.parameters import declare, value
from vgps_ros.ros_runtime.peers import HARDWARE_ID, INSTANCE, Peers
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.ros_runtime.steady_timer import steady_timer

_PERIOD = 1.0  # between two diagnostics [s]
# Between the first ones, so that a second node of a kind is found out before it does anything.
_FIRST_PERIOD = 0.1
_FIRST_COUNT = 12
_LOG_PERIOD = 10.0  # at least, between two equal lines in the log [s]
_LINE_PERIOD = 0.1  # at least, between two lines about the same thing [s]

WAIT_TIMEOUT = Setting(
    "wait_timeout",
    10.0,
    "time after which something still missing becomes an error on /diagnostics [s]",
    minimum=0.1,
    maximum=86400.0,
)


@dataclass
class _Wait:
    since: float  # [s], by the steady clock
    meanwhile: str
    is_late: bool = False


class Health:
    """Publishes one DiagnosticStatus a second on /diagnostics, and a fault at once.

    A node says what it waits for once, in a log line; if it still waits after the parameter
    `wait_timeout`, it says so once more as an error, and as the status ERROR until it is there.

    Args:
        node: the node, which has declared all its other parameters.
        owns: topics that only one node of the graph may publish. Of two nodes that say so of the
            same topic the one that was started later ends with a sentence.
        when_alone: called once it is clear that no other node owns one of these topics.

    Attributes:
        inbox: the subscriptions of the node, which bound the memory that messages take.
        peers: the other nodes.
    """

    def __init__(
        self,
        node: Node,
        *,
        owns: Sequence[str] = (),
        when_alone: Callable[[], object] = lambda: None,
    ):
        self._node = node
        self.inbox = Inbox(node)
        self.peers = Peers(node, self.inbox, owns)
        declare(node, WAIT_TIMEOUT, may_change=True)
        check_given_parameters(node)
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", STREAM)
        self._waiting: dict[str, _Wait] = {}
        self._faults: dict[str, tuple[bytes, str]] = {}  # level and sentence, by what it is about
        self._over: set[str] = set()
        self._said: dict[str, tuple[str, float]] = {}
        self._values = {INSTANCE: self.peers.instance, OWNS: " ".join(self.peers.owns)}
        self._ticks = 0
        self._when_alone = when_alone
        self._timer = steady_timer(node, _FIRST_PERIOD, self._tick)

    def wait_for(self, what: str, *, meanwhile: str = "") -> None:
        """Notes that the node waits, and says so once.

        Args:
            what: completes the sentence 'Waiting for …'.
            meanwhile: key of a value that another node shows on /diagnostics while it works on
                what is waited for; as long as one does, the wait does not become an error.
        """
        if what not in self._waiting:
            self._waiting[what] = _Wait(time.monotonic(), meanwhile)
            self._node.get_logger().info(f"Waiting for {what}.")

    def arrived(self, what: str) -> None:
        """Notes that the node no longer waits for it, since it came."""
        wait = self._waiting.pop(what, None)
        if wait and wait.is_late:
            self._node.get_logger().info(f"Here now: {what}.")

    def is_late(self, what: str) -> bool:
        """Returns whether the node has waited for it longer than `wait_timeout`."""
        return what in self._waiting and self._waiting[what].is_late

    def stop_waiting(self, *whats: str) -> None:
        """Notes that the node no longer needs these."""
        for what in whats:
            self._waiting.pop(what, None)

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
        self._log(about, is_new=before != level)
        if before != level:
            self._publish()

    def _log(self, about: str, *, is_new: bool = False) -> None:
        """Logs a fault, unless it was said already, or another line about it a moment ago."""
        level, sentence = self._faults[about]
        said, when = self._said.get(about, ("", 0.0))
        now = time.monotonic()
        again = is_new and now - when > _LOG_PERIOD
        if now - when <= _LINE_PERIOD or (sentence == said and not again):
            return
        # On lines of their own: rclpy refuses two severities from one.
        if level == DiagnosticStatus.ERROR:
            self._node.get_logger().error(sentence)
        else:
            self._node.get_logger().warning(sentence)
        self._said[about] = (sentence, now)

    def clear(self, *abouts: str) -> None:
        """Reports that faults are over; /diagnostics shows each once, however short it was."""
        self._over.update(about for about in abouts if about in self._faults)

    def set_value(self, key: str, value: object) -> None:
        """Shows a figure beside the status."""
        self._values[key] = str(value)

    def _tick(self) -> None:
        self._ticks += 1
        if self._ticks == _FIRST_COUNT:
            self._timer.timer_period_ns = round(_PERIOD * 1e9)
            self._when_alone()
        if self._ticks == 1:
            domain = self._node.context.get_domain_id()
            self.report("middleware", warning=middleware.trouble(domain))
        self.report("inbox", warning=self.inbox.warning())
        self.set_value("messages_dropped", self.inbox.dropped.total())
        timeout = value(self._node, WAIT_TIMEOUT)
        for what, wait in list(self._waiting.items()):
            if self.peers.show(wait.meanwhile):
                wait.since, wait.is_late = time.monotonic(), False
            elif time.monotonic() - wait.since > timeout and not wait.is_late:
                wait.is_late = True
                self._node.get_logger().error(
                    f"Still waiting for {what} after {timeout:g} s; is it running?"
                )
        for about in list(self._faults):
            self._log(about)  # what came too soon after another line
        self._publish()
        over, self._over = self._over, set()
        for about in over:
            self._faults.pop(about, None)

    def _publish(self) -> None:
        level, message = self._summary()
        status = DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name(),
            message=message,
            hardware_id=HARDWARE_ID,
            values=[KeyValue(key=k, value=v) for k, v in sorted(self._values.items())],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)

    def _summary(self) -> tuple[bytes, str]:
        """The worst level, and all sentences on what is wrong, the worst first."""
        said = list(self._faults.values())
        said += [(DiagnosticStatus.WARN, sentence) for sentence in self.peers.look()]
        for what, wait in list(self._waiting.items()):
            if wait.is_late:
                sentence = f"Still waiting for {what}; is it running?"
                said.append((DiagnosticStatus.ERROR, sentence))
            else:
                said.append((DiagnosticStatus.OK, f"Waiting for {what}."))
        well = DiagnosticStatus.OK
        said = sorted(said, key=itemgetter(0), reverse=True) or [(well, "Running.")]
        worst = said[0][0]
        return worst, " ".join(words for level, words in said if level != well or worst == well)
