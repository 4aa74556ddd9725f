# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Timers by the wall clock: simulated time may stand still just when something is wrong."""

from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer


def steady_timer(node: Node, period: float, callback: Callable[[], object]) -> Timer:
    """Calls back once a period [s], and is not moved by changes of the system's time either."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))
