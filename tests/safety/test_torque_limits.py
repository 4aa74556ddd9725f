"""Limits of torques and of their change."""

import mujoco
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vgps_ros.core.dynamics import CONTROL_BOUND
from vgps_ros.safety.torque_limits import TorqueLimiter
from vgps_ros.simulation.model import model_torque_limits

PERIOD = 20_000_000  # [ns]
LIMITS = np.array([2.0, 5.0])
TORQUES = st.lists(st.floats(-100, 100), min_size=2, max_size=2).map(np.array)


def limiter(rate=0.0):
    return TorqueLimiter(LIMITS, rate, PERIOD * 1e-9)


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
    joints = "".join(
        f'<body><joint name="{name}" axis="0 1 0" {limit}/><geom size="1"/></body>'
        for name, limit in (("a", ""), ("b", ""), ("c", 'actuatorfrcrange="-30 40"'), ("d", ""))
    )
    motors = (
        '<motor joint="a" ctrlrange="-3 4"/><motor joint="b" forcerange="-9 7"/>'
        '<motor joint="c" gear="2" ctrlrange="-50 50"/><motor joint="d"/>'
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler autolimits="true"/><worldbody>{joints}</worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )
    np.testing.assert_array_equal(model_torque_limits(model), [3.0, 7.0, 15.0, CONTROL_BOUND])
