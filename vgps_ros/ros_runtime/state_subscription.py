# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Subscribes to the states of a robot, on one topic or on several."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile

from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.messages.state_collector import StateCollector


def subscribe_to_states(
    subscribe: Callable[..., object],
    states: StateMessages,
    take: Callable[[dict[str, Any]], object],
    qos: QoSProfile,
) -> None:
    """Calls a function with the messages of each state by topic, once all of them are there.

    Args:
        subscribe: subscribes to one topic, as `Inbox.subscribe` and `Node.create_subscription` do.
        states: knows the topics.
        take: the function.
        qos: quality of service of each subscription.
    """
    collector = StateCollector(states.is_complete)

    def receive(topic: str, message: Any) -> None:
        if messages := collector.add(topic, message):
            take(messages)

    for topic, kind in states.sources.items():
        subscribe(kind, topic, partial(receive, topic), qos)
