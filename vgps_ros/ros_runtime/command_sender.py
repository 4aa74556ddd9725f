# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Sends the commands of a controller, and shows on /diagnostics how fast it answers states."""

import time
from collections.abc import Sequence
from typing import Any, Literal

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from vgps_ros.core.checks import one_of, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Setting
from vgps_ros.messages.conversions import command_to_msg, pack, stamp_of
from vgps_ros.robot.controls import INTERFACES, Controls
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare, value
from vgps_ros.ros_runtime.qos import STATES, lively
from vgps_ros.safety.supervisor import Answer

COMMAND_TYPE = Setting(
    "command_type",
    "joint_state",
    "joint_state: sensor_msgs/JointState on joint_command, stamped with the state's time; "
    "float64_multi_array: std_msgs/Float64MultiArray, as the forward controllers of ros2_control "
    "take it; the label of its dimension says what it holds",
    kind=Literal["joint_state", "float64_multi_array"],
)
COMMAND_INTERFACES = Setting(
    "command_interfaces",
    "",
    "names of position, velocity, effort, stiffness and damping, separated by commas, that a "
    "float64_multi_array holds; one: of all joints on commands, as position and effort controllers "
    "take it; several: of each joint on JOINT/commands, as multi-interface controllers take them; "
    "empty: the one of the controls' kind",
)
_PERIOD = 1.0  # over which figures are taken [s]
_FASTEST = 10.0  # of a simulation, in its seconds a second; stamps that go faster have jumped


class CommandSender:
    """Publishes commands as JointState, or as ros2_control's forward controllers take them.

    Args:
        node: the controller.
        names: of the joints that the controls drive.
        is_silent: whether nothing is ever sent.

    Attributes:
        topics: of the commands.
        kind: their type.
        sent: how many were sent.
    """

    def __init__(self, node: Node, names: Sequence[str], *, is_silent: bool):
        self._node, self.sent = node, 0
        self._is_plain = declare(node, COMMAND_TYPE) == "float64_multi_array"
        self.kind: Any = Float64MultiArray if self._is_plain else JointState
        self.topics = ["commands" if self._is_plain else "joint_command"]
        if "," in declare(node, COMMAND_INTERFACES) and self._is_plain:
            self.topics = [f"{name}/commands" for name in names]
        opened, qos = [] if is_silent else self.topics, lively(STATES)
        self._publishers = [node.create_publisher(self.kind, topic, qos) for topic in opened]

    def interfaces(self, controls: Controls) -> list[str]:
        """Returns the interfaces that a command has for each joint; by default the controls' kinds.

        Raises:
            InvalidInputError: the parameter command_interfaces does not suit the controls.
        """
        names = value(self._node, COMMAND_INTERFACES)
        found = [name.strip() for name in names.split(",") if name.strip()] or [*controls.fields]
        for name in found:
            one_of("command_interfaces", name, INTERFACES)
        if missing := [name for name in controls.fields if name not in found]:
            raise InvalidInputError(
                f"command_interfaces is {quote(names)}, but the controls are {controls.label()}; "
                f"name {missing[0]}, too."
            )
        if self._is_plain and self.topics == ["commands"] and len(found) > 1:
            raise InvalidInputError(
                f"one array on commands cannot hold controls that are {controls.label()}; set "
                f"command_interfaces to '{','.join(found)}', which go to JOINT/commands."
            )
        return found

    def send(self, command: Answer, controls: Controls, interfaces: Sequence[str]) -> None:
        """Publishes a command for these interfaces of these controls."""
        self.sent += 1
        messages = [command_to_msg(command.control, controls, stamp_of(command.stamp))]
        if self._is_plain:
            rows = controls.by_interface(command.control, interfaces)
            is_per_joint = len(self._publishers) > 1
            label = ",".join(interfaces)
            messages = [_array(values, label) for values in (rows.T if is_per_joint else rows)]
        for publisher, message in zip(self._publishers, messages, strict=True):
            publisher.publish(message)


def _array(values: Array, label: str) -> Float64MultiArray:
    """Returns numbers with a label that says which interfaces they are for."""
    dimension = MultiArrayDimension(label=label, size=len(values), stride=len(values))
    return Float64MultiArray(layout=MultiArrayLayout(dim=[dimension]), data=pack(values))


class AnswerTimes:
    """Shows on /diagnostics how often a controller answers, how fast, and what it missed.

    The figures are those of ros2_control's controller_manager. A state is missed where the stamps
    of the states that are answered have a gap; the control period is in seconds. Where the stamps
    went back, or far ahead of the time that passed, the clock jumped, and nothing was missed.
    """

    def __init__(self, health: Health, period: float):
        self._health = health
        self._period = round(period * 1e9)
        self._stamp: int | None = None
        self._missed = self._states = self._jumps = 0
        self._answered = time.monotonic()
        self._begin()

    def _begin(self) -> None:
        self._since, self._count, self._spent, self._longest = time.monotonic(), 0, 0.0, 0.0

    def answered(self, stamp: int, seconds: float) -> None:
        """Notes the stamp [ns] of a state that was answered, and the time that it took [s]."""
        now = time.monotonic()
        step = 0 if self._stamp is None else stamp - self._stamp
        has_jumped = not 0.0 <= step * 1e-9 <= _PERIOD + _FASTEST * (now - self._answered)
        gap = 0 if has_jumped else max(0, step // self._period - 1)
        self._stamp, self._answered = stamp, now
        self._jumps += has_jumped
        self._missed += gap
        self._states += 1 + gap
        self._count += 1
        self._spent += seconds
        self._longest = max(self._longest, seconds)
        if (passed := now - self._since) > _PERIOD:
            mean, longest = 1e3 * self._spent / self._count, 1e3 * self._longest
            self._health.set_value("periodicity", f"{self._count / passed:.1f} Hz")
            self._health.set_value("execution time", f"mean {mean:.2f}, longest {longest:.2f} ms")
            self._health.set_value("missed deadlines", f"{self._missed} of {self._states}")
            self._health.set_value("clock jumps", self._jumps)
            self._begin()
