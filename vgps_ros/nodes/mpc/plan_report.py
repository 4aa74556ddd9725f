# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The figures on plans that the node `mpc` shows on /diagnostics."""

import time

from vgps_ros.messages.names import PLAN_AGE, PLAN_COST, PLAN_DURATION
from vgps_ros.ros_runtime.health import Health

_PERIOD = 1.0  # over which the rate of the plans is counted [s]


class PlanReport:
    """Shows the rate, the age, the cost and the duration of plans."""

    def __init__(self, health: Health):
        self._health = health
        self._since, self._count = time.monotonic(), 0

    def answer(self, age: float) -> None:
        """Notes the age [s] of the plan by which a state was answered."""
        self._health.set_value(PLAN_AGE, f"{age:.3f} s")

    def plan(self, cost: float, seconds: float) -> None:
        """Notes a new plan's cost, and the time that it took [s]."""
        self._count += 1
        passed = time.monotonic() - self._since
        if passed > _PERIOD:
            self._health.set_value("plan rate", f"{self._count / passed:.1f} Hz")
            self._since, self._count = time.monotonic(), 0
        self._health.set_value(PLAN_COST, f"{cost:.4g}")
        self._health.set_value(PLAN_DURATION, f"{1e3 * seconds:.1f} ms")
