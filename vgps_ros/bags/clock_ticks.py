# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Adds ticks of /clock to the messages of a bag, for bags in which nobody recorded a clock."""

import struct
from collections.abc import Iterable, Iterator

from vgps_ros.bags.reader import BagMessage

CLOCK_TOPIC, CLOCK_KIND = "/clock", "rosgraph_msgs/msg/Clock"

_CDR_HEADER = bytes((0, 1, 0, 0))  # little endian


def with_clock(messages: Iterable[BagMessage], period: int) -> Iterator[BagMessage]:
    """Yields the messages, and before each message the ticks of /clock that are due by then.

    Args:
        messages: messages in the order in which they were received; the first starts the clock.
        period: time between two ticks [ns].
    """
    tick: int | None = None
    for message in messages:
        tick = message.stamp if tick is None else tick
        while tick <= message.stamp:
            time = _CDR_HEADER + struct.pack("<iI", *divmod(tick, 10**9))
            yield BagMessage(CLOCK_TOPIC, CLOCK_KIND, tick, time)
            tick += period
        yield message
