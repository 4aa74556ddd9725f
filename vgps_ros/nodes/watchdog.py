# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `watchdog`: sends zero torque where a controller that drives has fallen silent.

Motors, and the forward controllers of ros2_control, hold the last torque or velocity that they were
sent, also of a controller that was killed or hangs. Targets of positions are left alone: they hold,
and zeros would move the robot. The label of an array of numbers says what they are.
"""

import time
from array import array
from functools import partial
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from vgps_ros.core.checks import quote
from vgps_ros.core.settings import Range, Setting
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare, value
from vgps_ros.ros_runtime.qos import NEWEST, STATES
from vgps_ros.ros_runtime.runner import Runnable, streaming_executor
from vgps_ros.ros_runtime.services import steady_timer

SILENCE = Setting(
    "silence",
    0.1,
    Range(0.001, 10.0),
    "time after a torque other than zero from which on the next one is missed [s]",
)
TOPICS = {"joint_command": JointState, "commands": Float64MultiArray}
STOPPED_BY_ZERO = ("effort", "velocity")


class Watchdog(Node):
    """Hears the commands of a controller, and its own."""

    def __init__(self) -> None:
        super().__init__("watchdog")
        silence = declare(self, SILENCE)
        self._health = Health(self)
        self._newest: dict[str, tuple[float, Any]] = {}  # by topic: when it came [s], and it
        self._zeros = {t: self.create_publisher(kind, t, STATES) for t, kind in TOPICS.items()}
        for topic, kind in TOPICS.items():
            self.create_subscription(kind, topic, partial(self._take, topic), NEWEST)
        steady_timer(self, silence / 4, self._look)

    def _take(self, topic: str, message: Any) -> None:
        self._newest[topic] = time.monotonic(), message
        if topic == "commands":
            label, warning = _label(message), ""
            if label not in (*STOPPED_BY_ZERO, "position"):
                warning = (
                    "Arrays on commands are left alone, since layout.dim[0].label is "
                    f"{quote(label)}; set it to effort, velocity or position."
                )
            self._health.report("label", warning=warning)

    def _look(self) -> None:
        """Sends zeros on a topic whose last torques are not zero, and are old."""
        silence = value(self, SILENCE)
        for topic, (received, message) in self._newest.items():
            if isinstance(message, JointState):
                driving = [message.effort, message.velocity]
            else:
                driving = [message.data] if _label(message) in STOPPED_BY_ZERO else []
            # NaN stands where a joint has another kind of command.
            if not any(number for values in driving for number in values if number == number):
                self._health.clear(topic)
            elif time.monotonic() - received > silence:
                for values in driving:
                    values[:] = array("d", [0.0 * number for number in values])
                self._zeros[topic].publish(message)
                sentence = f"No {topic} came for {silence:g} s after a torque: zeros were sent."
                self._health.report(topic, error=sentence)


def _label(message: Float64MultiArray) -> str:
    """Returns what an array says that its numbers are; nothing where it says nothing."""
    return message.layout.dim[0].label if message.layout.dim else ""


NODE = Runnable(Watchdog, streaming_executor)
