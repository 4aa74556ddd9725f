# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The figures on /diagnostics by which a controller and its robot show that torques come in time.

They are those of ros2_control's controller_manager: periodicity, execution time and overruns. The
robot's end adds how old a torque is, since that is what the motors feel.
"""

import time

from vgps_ros.ros_runtime.health import Health

_PERIOD = 1.0  # over which figures are taken [s]


class AnswerPace:
    """Shows how often a controller answers, how long that takes it, and how many states it missed.

    A state is missed where the next one comes while an earlier one is still being answered: the
    stamps of the states that are answered then have a gap.

    Args:
        health: the node's diagnostics.
        period: the control period [s].
    """

    def __init__(self, health: Health, period: float):
        self._health = health
        self._period = round(period * 1e9)
        self._stamp: int | None = None
        self._missed = self._states = 0
        self._begin()

    def _begin(self) -> None:
        self._since, self._count, self._spent, self._longest = time.monotonic(), 0, 0.0, 0.0

    def answered(self, stamp: int, seconds: float) -> None:
        """Notes the stamp [ns] of a state that was answered, and the time that it took [s]."""
        gap = 0 if self._stamp is None else (stamp - self._stamp) // self._period - 1
        self._stamp = stamp
        self._missed += max(0, gap)
        self._states += 1 + max(0, gap)
        self._count += 1
        self._spent += seconds
        self._longest = max(self._longest, seconds)
        if (passed := time.monotonic() - self._since) > _PERIOD:
            mean, longest = 1e3 * self._spent / self._count, 1e3 * self._longest
            self._health.set_value("periodicity", f"{self._count / passed:.1f} Hz")
            self._health.set_value("execution time", f"mean {mean:.2f}, longest {longest:.2f} ms")
            self._health.set_value("missed deadlines", f"{self._missed} of {self._states}")
            self._begin()


class TorqueAge:
    """Shows for how many control steps a robot holds each torque, where it needs a new one in each.

    Args:
        health: the node's diagnostics.
        limit: number of steps from which on that is an error.
    """

    def __init__(self, health: Health, limit: int):
        self._health = health
        self._limit = limit
        self._overruns = self._steps = 0
        self._begin()

    def _begin(self) -> None:
        self._since, self._ages, self._oldest, self._count = time.monotonic(), 0, 0, 0

    def held(self, age: int) -> None:
        """Notes a step under a torque whose state is so many steps older than the newest one."""
        self._steps += 1
        self._overruns += age > 0
        self._ages += age
        self._count += 1
        self._oldest = max(self._oldest, age)
        if age == self._limit:
            sentence = (
                f"A torque was held for {age} control steps or more, but each step needs a new "
                "one: give the controller more of the processor, or bring it nearer."
            )
            self._health.report("torque age", error=sentence)
        if time.monotonic() - self._since > _PERIOD:
            if self._oldest < self._limit:
                self._health.clear("torque age")
            mean = self._ages / self._count
            self._health.set_value("torque age", f"mean {mean:.2f}, largest {self._oldest} steps")
            self._health.set_value("overruns", f"{self._overruns} of {self._steps}")
            self._begin()
