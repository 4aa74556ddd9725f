# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads the states of a robot from a bag."""

from collections.abc import Iterator
from typing import Any

from vgps_ros.bags import BagReader
from vgps_ros.messages.robot_state import StateCollector, StateMessages


def recorded_states(bag: BagReader, states: StateMessages) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yields when each state was complete [ns], and its messages by topic.

    Raises:
        InvalidInputError: the bag lacks one of the topics, or a message fits no definition.
    """
    names = {bag.needed_topic(name): name for name in states.topics}
    names |= {bag.filled_topics[name]: name for name in states.sources if name in bag.filled_topics}
    collector = StateCollector(states.is_complete)
    for message in bag.messages(list(names)):
        if found := collector.add(names[message.topic], bag.decode(message)):
            yield message.stamp, found
