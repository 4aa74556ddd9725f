# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The figures on plans that the node `mpc` shows on /diagnostics."""

import time

from vgps_ros.ros_runtime.health import Health

_PERIOD = 1.0  # over which the rate of the plans is counted [s]


class PlanReport:
    """Shows the rate, the age, the cost and the duration of plans, and the missed states.

    A state is missed where the next one comes while an earlier one is still being answered: the
    stamps of the states that are answered then have a gap.
    """

    def __init__(self, health: Health):
        self._health = health
        self._since, self._count = time.monotonic(), 0
        self._step: int | None = None
        self._missed = self._states = 0

    def state(self, step: int) -> None:
        """Notes the control step of a state that will be answered."""
        gap = 0 if self._step is None else max(0, step - self._step - 1)
        self._step = step
        self._states += 1 + gap
        self._missed += gap
        self._health.set_value("missed deadlines", f"{self._missed} of {self._states}")

    def answer(self, age: float) -> None:
        """Notes the age [s] of the plan by which a state was answered."""
        self._health.set_value("plan age", f"{age:.3f} s")

    def plan(self, cost: float, seconds: float) -> None:
        """Notes a new plan's cost, and the time that it took [s]."""
        self._count += 1
        passed = time.monotonic() - self._since
        if passed > _PERIOD:
            self._health.set_value("plan rate", f"{self._count / passed:.1f} Hz")
            self._since, self._count = time.monotonic(), 0
        self._health.set_value("plan cost", f"{cost:.4g}")
        self._health.set_value("plan duration", f"{1e3 * seconds:.1f} ms")
