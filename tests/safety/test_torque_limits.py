# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Limits of torques and of their change."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.motors import motors, robot
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.supervisor import ControlLimiter
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import control_range

PERIOD = 20_000_000  # [ns]
LIMITS = np.array([2.0, 5.0])
TORQUES = st.lists(st.floats(-100, 100), min_size=2, max_size=2).map(np.array)


def limiter(rate=0.0):
    settings = SafetySettings(torque_rate_limit=rate)
    return Limiter(ControlLimiter(settings, motors(*LIMITS), PERIOD * 1e-9))


class Limiter:
    """A limiter of motors, whose limits do not depend on the state."""

    def __init__(self, limiter):
        self._limiter, self.note, self.note_safe = limiter, limiter.note, limiter.note_safe

    def limited(self, torques, stamp):
        return self._limiter.limited(torques, stamp, np.zeros(4))


def test_torques_within_the_limits_keep_every_bit_and_others_are_clipped():
    np.testing.assert_array_equal(limiter().limited(np.array([0.1, -4.9]), 0), [0.1, -4.9])
    np.testing.assert_array_equal(limiter().limited(np.array([-3.0, np.inf]), 0), [-2.0, 5.0])


def test_the_change_grows_with_the_time_between_states_up_to_a_period():
    limit = limiter(rate=10.0)  # 0.2 N·m in a period
    limit.note(np.zeros(2), 0)
    for elapsed, change in ((PERIOD // 4, 0.05), (PERIOD, 0.2), (100 * PERIOD, 0.2)):
        found = limit.limited(np.array([1.0, -1.0]), elapsed)
        np.testing.assert_allclose(found, [change, -change], rtol=1e-12)


def test_a_repeated_state_gets_the_same_torques_and_time_that_goes_back_starts_from_zero():
    limit = limiter(rate=10.0)
    for t in range(5):
        torques = limit.limited(LIMITS, t * PERIOD)
        limit.note(torques, t * PERIOD)
        np.testing.assert_array_equal(limit.limited(LIMITS, t * PERIOD), torques)
    np.testing.assert_allclose(torques, [1.0, 1.0])
    np.testing.assert_allclose(limit.limited(LIMITS, 0), [0.2, 0.2])

    np.testing.assert_allclose(limit.limited(LIMITS, 2 * PERIOD), [0.2, 0.2])


def test_the_change_counts_from_the_latest_earlier_state_wherever_time_began():
    limit = limiter(rate=10.0)
    limit.note(np.array([1.0, 1.0]), 7 * PERIOD)
    later = 7 * PERIOD + PERIOD // 4
    np.testing.assert_allclose(limit.limited(LIMITS, later), [1.05, 1.05])
    limit.note(np.array([1.05, 1.05]), later)
    # The same state comes again, and the policy wants something else.
    np.testing.assert_allclose(limit.limited(-LIMITS, later), [0.95, 0.95])


def test_after_the_safe_action_a_whole_period_counts():
    limit = limiter(rate=10.0)
    limit.note_safe(np.array([1.0, -1.0]))
    np.testing.assert_allclose(limit.limited(LIMITS, PERIOD // 4), [1.2, -0.8])


@given(st.lists(st.tuples(st.integers(0, 3 * PERIOD), TORQUES), max_size=20))
def test_no_sequence_of_torques_breaks_a_limit(steps):
    limit, stamp, last = limiter(rate=7.0), 0, np.zeros(2)
    for elapsed, torques in steps:
        stamp += elapsed
        sent = limit.limited(torques, stamp)
        limit.note(sent, stamp)
        assert (np.abs(sent) <= LIMITS).all()
        # Of a repeat, the change counts from the state before.
        if elapsed:
            assert (np.abs(sent - last) <= 7.0 * PERIOD * 1e-9 + 1e-12).all()
            last = sent


def test_the_models_own_limits_are_found_in_newton_metres():
    range_ = 'actuatorfrcrange="-30 40"'
    joints = "".join(
        f'<body><joint name="{name}" axis="0 1 0" {limit}/><geom size="1"/></body>'
        for name, limit in {**dict.fromkeys("abcdef", ""), "c": range_, "f": range_}.items()
    )
    motors = (
        '<motor joint="a" ctrlrange="-3 4"/><motor joint="b" forcerange="-9 7" gear="-3"/>'
        '<motor joint="c" gear="-2" ctrlrange="-50 50"/><motor joint="d"/>'
        '<position joint="e" kp="50" forcerange="-5 5" ctrlrange="-1 2"/>'
        '<motor joint="f"/><motor joint="f" ctrlrange="8 9" forcerange="-1 1"/>'
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler autolimits="true"/><worldbody>{joints}</worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )
    none = np.inf
    low, high = control_range(model)
    np.testing.assert_array_equal(low, [-3.0, -9.0, -20.0, -none, -1.0, -none, 8.0])
    np.testing.assert_array_equal(high, [4.0, 7.0, 15.0, none, 2.0, none, 8.0])


def test_torques_keep_to_the_robots_limits_and_to_the_users():
    def controls(*ranges):
        own = [f'<motor joint="{{}}" ctrlrange="{low} {high}"/>' for low, high in ranges]
        return controls_of(robot(*own))

    settings = SafetySettings(torque_limits=(2.0, 5.0))
    of_robot = controls((-1, 3), (-9, 9))
    low, high = of_robot.bounds(np.zeros(4), settings.torques_of(of_robot))
    np.testing.assert_array_equal(low, [-1.0, -5.0])
    np.testing.assert_array_equal(high, [2.0, 5.0])
    with pytest.raises(InvalidInputError, match=r"torque_limits\[1\] is 5, .*own.* 6 at least"):
        settings.torques_of(controls((-1, 1), (6, 7)))
    with pytest.raises(InvalidInputError, match="torque_limits"):
        SafetySettings(torque_limits=(2.0, 5.0, 1.0)).torques_of(of_robot)
    alone = controls((2, 2.5), (5, 5.5))
    low, high = alone.bounds(np.zeros(4), settings.torques_of(alone))
    np.testing.assert_array_equal(low, high)  # a robot may allow a single torque
