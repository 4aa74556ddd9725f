"""What a node says of itself: diagnostics, and what it is waiting for."""

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from vgps_ros.core.settings import Setting
from vgps_ros.nodes.parameters import declare
from vgps_ros.nodes.qos import STREAM

_PERIOD = 1.0  # between two diagnostics [s]
_LOG_PERIOD = 10.0  # at least, between two equal lines in the log [s]

WAIT_TIMEOUT = Setting(
    "wait_timeout",
    10.0,
    "time after which something still missing becomes an error on /diagnostics [s]",
    minimum=0.1,
    maximum=86400.0,
)


class Health:
    """Publishes one DiagnosticStatus a second on /diagnostics.

    A node says what it waits for once, in a log line; if it still waits after the parameter
    `wait_timeout`, it says so once more as an error, and as the status ERROR until it is there.
    """

    def __init__(self, node: Node):
        self._node = node
        self._timeout = declare(node, WAIT_TIMEOUT)
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", STREAM)
        self._waiting: dict[str, float] = {}
        self._late: set[str] = set()
        self._errors: dict[str, str] = {}  # by what they are about
        self._over: set[str] = set()
        self._said: dict[str, tuple[str, float]] = {}
        self._values: dict[str, str] = {}
        # Wall time: simulated time may stand still just when something is wrong.
        self._timer = node.create_timer(
            _PERIOD, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def wait_for(self, what: str) -> None:
        """Notes that the node waits, and says so once. `what` completes 'Waiting for …'."""
        if what not in self._waiting:
            self._waiting[what] = time.monotonic()
            self._node.get_logger().info(f"Waiting for {what}.")

    def arrived(self, what: str) -> None:
        """Notes that the node no longer waits for it, since it came."""
        if what in self._late:
            self._node.get_logger().info(f"Here now: {what}.")
        self.stop_waiting(what)

    def stop_waiting(self, what: str) -> None:
        """Notes that the node no longer needs it."""
        self._waiting.pop(what, None)
        self._late.discard(what)

    def error(self, sentence: str, about: str = "") -> None:
        """Reports a fault: on /diagnostics until it is cleared, and in the log, but not often.

        Args:
            sentence: what is wrong, and what would be right.
            about: faults about different things are reported and cleared on their own.
        """
        said, when = self._said.get(about, ("", 0.0))
        now = time.monotonic()
        if (about not in self._errors and now - when > _LOG_PERIOD) or sentence != said:
            self._node.get_logger().error(sentence)
            self._said[about] = (sentence, now)
        self._errors[about] = sentence
        self._over.discard(about)

    def clear(self, about: str = "") -> None:
        """Reports that a fault is over; /diagnostics shows it once, however short it was."""
        if about in self._errors:
            self._over.add(about)

    def set_value(self, key: str, value: object) -> None:
        """Shows a figure beside the status."""
        self._values[key] = str(value)

    def _tick(self) -> None:
        for what, since in list(self._waiting.items()):
            if time.monotonic() - since > self._timeout and what not in self._late:
                self._late.add(what)
                self._node.get_logger().error(
                    f"Still waiting for {what} after {self._timeout:g} s; is it running?"
                )
        level, message = self._summary()
        status = DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name(),
            message=message,
            hardware_id="vgps_ros",
            values=[KeyValue(key=k, value=v) for k, v in sorted(self._values.items())],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
        over, self._over = self._over, set()
        for about in over:
            self._errors.pop(about, None)

    def _summary(self) -> tuple[bytes, str]:
        if self._errors:
            return DiagnosticStatus.ERROR, " ".join(self._errors.values())
        late = [what for what in self._waiting if what in self._late]
        if late:
            return DiagnosticStatus.ERROR, f"Still waiting for {late[0]}; is it running?"
        if self._waiting:
            return DiagnosticStatus.OK, f"Waiting for {next(iter(self._waiting))}."
        return DiagnosticStatus.OK, "Running."
