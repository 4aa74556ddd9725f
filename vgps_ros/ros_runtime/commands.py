# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Holds what a controller is told: commands that come by topics, and the clock.

| topic | type | holds |
| --- | --- | --- |
| `cmd_vel` | geometry_msgs/TwistStamped, or Twist | commands whose source is one of its fields |
| `command` | vgps_msgs/Signals | any commands, by name |
| `context` | vgps_msgs/Signals | what was used with the answer to a state; published |

A task without commands has none of the first two, and one that tells its policies nothing has none.
Parameters of the node tell the names, ranges, sources and units of the commands.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node
from vgps_msgs.msg import Signals as SignalsMsg

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Range, Setting
from vgps_ros.messages.conversions import (
    commands_from_twist,
    nanoseconds,
    signals_from_msg,
    signals_to_msg,
    stamp_of,
)
from vgps_ros.messages.names import CMD_VEL, COMMAND, CONTEXT
from vgps_ros.robot.deployment import Deployment
from vgps_ros.robot.signals import SOURCE, Command, Signals
from vgps_ros.robot.unrest import Unrest, Waking
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare, declare_fact, value
from vgps_ros.ros_runtime.qos import COMMANDED, STATES

STAMPED_CMD_VEL = Setting(
    "stamped_cmd_vel",
    True,
    "true: cmd_vel is geometry_msgs/TwistStamped, whose frame must be that of "
    "the robot's base or empty; false: it is geometry_msgs/Twist",
)
COMMAND_TIMEOUT = Setting(
    "command_timeout",
    0.5,
    Range(1e-3, 1e6),
    "time after its receipt, by the node's clock, from which a command is at rest, which is zero "
    "or what of its range is nearest to zero; one whose stamp is older as it comes is refused [s]",
)

_OTHER_CLOCK = 86400.0  # between a stamp and the node's clock, which then are of two clocks [s]

# Parameters that tell what the commands are, a list for each field of a command.
FACTS = {f"commands.{field.name}": field.name for field in dataclasses.fields(Command)}


def commands_of(facts: Sequence[Sequence[Any]]) -> list[Command]:
    """Returns the commands that the values of another node's `FACTS` tell.

    Raises:
        InvalidInputError: they tell no commands.
    """
    try:
        commands = [Command(*fields) for fields in zip(*facts, strict=True)]
        is_right = all(-np.inf < c.lowest <= c.highest < np.inf for c in commands)
        is_right &= all(SOURCE.fullmatch(c.source) for c in commands if c.source)
    except (TypeError, ValueError):
        is_right = False
    if not is_right:
        raise InvalidInputError(
            f"The parameters {', '.join(FACTS)} must be lists of one length, with finite ranges "
            "and fields of cmd_vel."
        )
    return commands


class Instructions:
    """Takes commands, and gives each state its context; a wrong message changes nothing.

    Args:
        node: the controller, which has declared the parameters of its commands.
        health: its diagnostics.
        robot: what is known of its task.
        base_frame: the frame in which cmd_vel must be.

    Attributes:
        commands: those in the newest state, shape (n_c,).
        phase: the clock's φ there, in turns.
        context: both of them, as policies read them, shape (n_z,).
    """

    def __init__(self, node: Node, health: Health, robot: Deployment, base_frame: str):
        self._node, self._health, self._signals = node, health, (signals := robot.signals)
        self.commands, self.phase, self.context = signals.rest, 0.0, signals.rest
        unrest = Unrest.of(signals, robot.layout, robot.initial_state)
        self._waking = Waking(unrest, robot.time_step) if unrest else None
        self._now = signals  # with a clock that turns while the robot has to step
        self._names = [command.name for command in signals.commands]
        self._given = signals.rest.copy()
        self._received = np.full(len(self._names), np.iinfo(np.int64).min // 2)  # [ns]
        make = node.create_publisher
        self._contexts = make(SignalsMsg, CONTEXT, STATES) if signals.names else None
        if self._names:
            self._subscribe(SignalsMsg, COMMAND, signals_from_msg)
        if any(command.source for command in signals.commands):
            kind = TwistStamped if value(node, STAMPED_CMD_VEL) else Twist
            read = partial(commands_from_twist, commands=signals.commands, base_frame=base_frame)
            self._subscribe(kind, CMD_VEL, read)

    @staticmethod
    def declare(node: Node, signals: Signals) -> None:
        """Declares the parameters of commands, where there are any."""
        if signals.commands:
            declare(node, COMMAND_TIMEOUT, may_change=True)
            for fact, field in FACTS.items():
                found = tuple(getattr(command, field) for command in signals.commands)
                declare_fact(node, Setting(fact, found, "of the task's commands"))
        if any(command.source for command in signals.commands):
            declare(node, STAMPED_CMD_VEL)

    def at(self, stamp: int, state: Array) -> Array:
        """Returns the context in a state (n_x,) of a stamp [ns], and publishes it."""
        if self._contexts is None:
            return self.context
        signals = self._signals
        age = (self._node.get_clock().now().nanoseconds - self._received) * 1e-9
        is_fresh = (age >= 0.0) & (age <= self._timeout)
        self.commands = np.where(is_fresh, self._given, signals.rest)
        self.phase = signals.phase_at(stamp)
        is_awake = self._waking is not None and self._waking.is_awake(state, stamp)
        self._now = signals.turning if is_awake else signals
        for command, number in zip(signals.commands, self.commands.tolist(), strict=True):
            said = f"{number:.3g} {command.unit}".rstrip()
            self._health.set_value(f"{COMMAND} {command.name}", said)
        self.context = self._now.context(self.commands, np.array(self.phase))
        self._contexts.publish(signals_to_msg(self.context, signals.names, stamp_of(stamp)))
        return self.context

    def ahead(self, steps: int) -> Array:
        """Returns the context of the newest state and of those after it, (steps, n_z).

        The commands are held.
        """
        return self._now.constant_context(self.commands, steps, self.phase)

    @property
    def _timeout(self) -> float:
        return float(value(self._node, COMMAND_TIMEOUT)) if self._names else 0.0

    def _subscribe(
        self, kind: type, topic: str, values_of: Callable[[Any], dict[str, float]]
    ) -> None:
        def take(message: Any) -> None:
            try:
                self._check_age(message)
                clamped = self._take(values_of(message))
            except InvalidInputError as error:
                sentence = f"Refused a {topic}; any before it stays: {error}"
                self._health.report(topic, error=sentence)
            else:
                self._health.report(topic, warning=clamped)

        self._node.create_subscription(kind, topic, take, COMMANDED)

    def _check_age(self, message: Any) -> None:
        """Refuses a command that was sent long ago, as a link that was down may bring many at once.

        A stamp of another clock tells nothing, such as one of simulated time, or zero.
        """
        if not hasattr(message, "header"):
            return
        now, stamp = self._node.get_clock().now().nanoseconds, nanoseconds(message.header.stamp)
        if stamp and self._timeout < (age := (now - stamp) * 1e-9) < _OTHER_CLOCK:
            raise InvalidInputError(
                f"it was sent {age:.2g} s ago, but command_timeout is {self._timeout:g} s; "
                "synchronise the clocks of both machines, mend the link, or raise command_timeout."
            )

    def _take(self, given: dict[str, float]) -> str:
        """Takes the values of some commands; says which of them are out of their ranges."""
        taken, said = self._signals.clamped(given)
        for i, number in taken.items():
            self._given[i], self._received[i] = number, self._node.get_clock().now().nanoseconds
        return f"Clamped what was commanded: {'; '.join(said)}." if said else ""
