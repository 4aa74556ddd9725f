# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Who drives: the policy, or the safe action."""

import numpy as np
import pytest

from tests.motors import motors
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.supervisor import Supervisor
from vgps_ros.safety.training_marginals import TrainingMarginals

PERIOD = 20_000_000  # [ns]
LIMITS = (10.0, 10.0)
STATE = np.array([0.1, 0.2, 1.0, -2.0])
TORQUES = np.array([3.0, -4.0])


class Robot:
    """A supervisor and a clock."""

    def __init__(self, broken_limit=lambda _: "", **settings):
        controls, period = motors(*LIMITS), PERIOD * 1e-9
        self.supervisor = Supervisor(SafetySettings(**settings), controls, period, broken_limit)
        self.supervisor.begin()
        self.now = 0.0

    def send(self, step, state=STATE, torques=TORQUES, age=0.0):
        """Sends a state; returns the torques and the stamp that answer it."""
        self.now += PERIOD * 1e-9
        command = self.supervisor.answer(
            state, step * PERIOD, lambda: age, self.now, lambda: torques
        )
        return command and (command.control.tolist(), command.stamp // PERIOD)

    def wait(self, duration):
        self.now += duration
        command = self.supervisor.watch(self.now)
        return command and (command.control.tolist(), command.stamp // PERIOD)

    @property
    def fault(self):
        return self.supervisor.fault or ""


DRIVES = TORQUES.tolist()
ZERO = [0.0, 0.0]


def test_good_states_are_answered_by_the_policy_and_repeats_likewise():
    robot = Robot()
    for step in (0, 1, 1, 2, 7):
        assert robot.send(step) == (DRIVES, step)
        assert robot.wait(0.1) is None
    assert not robot.fault


@pytest.mark.parametrize("recovery", ["automatic", "manual"])
def test_a_state_that_was_overtaken_is_left_out_and_the_policy_goes_on(recovery):
    robot = Robot(recovery=recovery)
    robot.send(5)
    assert robot.send(4) is None
    assert not robot.fault
    assert robot.supervisor.warning == (
        "A state came after one that is 0.02 s newer, and was left out; if that goes on, check "
        "that only one robot publishes joint_states."
    )
    assert robot.wait(0.02) is None
    assert robot.send(6) == (DRIVES, 6)
    assert not robot.supervisor.warning


def test_a_state_that_was_overtaken_ends_no_fault_and_is_no_sign_of_life():
    robot = Robot(broken_limit=lambda state: "it leans." if state[0] > 1.0 else "")
    robot.send(5, state=STATE + 1.0)
    assert robot.send(4) is None
    assert robot.fault == "it leans."
    robot = Robot(state_timeout=1.0)
    robot.send(5)
    for _ in range(4):
        robot.wait(0.2)
        assert robot.send(4) is None
    assert robot.wait(0.2) == (ZERO, 5)
    assert "no usable joint_states came for 1 s" in robot.fault
    assert robot.send(3) == (DRIVES, 3)


def test_the_stamp_zero_begins_a_new_time():
    robot = Robot()
    robot.send(500)
    for step in (0, 0, 1, 2):
        assert robot.send(step) == (DRIVES, step)


def test_after_a_silence_the_order_is_forgotten():
    robot = Robot(state_timeout=1.0)
    robot.send(500)
    assert robot.wait(0.9) is None
    assert robot.send(499) is None
    assert robot.wait(1.1) == (ZERO, 500)
    assert robot.send(499) == (DRIVES, 499)


def test_silence_leads_to_the_safe_action_and_its_end_back():
    robot = Robot(state_timeout=1.0, safe_action="damping", damping=2.0)
    assert robot.wait(100.0) is None  # nothing was sent before, so nothing is to be undone
    robot.send(0)
    assert robot.wait(0.99) is None
    # The last state is too old to brake by it.
    assert robot.wait(0.02) == (ZERO, 0)
    assert "no usable joint_states came for 1 s" in robot.fault
    assert robot.send(1) == (DRIVES, 1)
    assert not robot.fault


def test_damping_brakes_by_the_last_usable_state_within_the_limits():
    robot = Robot(safe_action="damping", damping=2.0)
    robot.send(0)
    assert robot.send(-1) == ([-2.0, 4.0], 0)
    robot.send(1, state=100 * STATE)
    assert robot.send(-1) == ([-10.0, 10.0], 1)


@pytest.mark.parametrize(("age", "good"), [(0.0, True), (0.1, True), (0.11, False), (-3.0, False)])
def test_a_state_whose_age_is_wrong_is_refused(age, good):
    robot = Robot(max_state_age=0.1)
    robot.send(0)
    assert robot.send(1, age=age) == ((DRIVES, 1) if good else (ZERO, 0))
    assert ("max_state_age is 0.1 s" in robot.fault) is not good


def test_torques_that_are_not_finite_lead_to_the_safe_action_in_this_state():
    robot = Robot()
    assert robot.send(3, torques=np.array([np.nan, 1.0])) == (ZERO, 3)
    assert "the policy's output is [nan  1.]" in robot.fault
    assert robot.send(4) == (DRIVES, 4)


def test_by_hand_the_safe_action_stays_until_a_new_begin():
    robot = Robot(recovery="manual")
    robot.send(0)
    robot.supervisor.refuse("it was wrong", robot.now)
    for step in (1, 2):
        assert robot.send(step) == (ZERO, step)
    robot.send(1)
    assert robot.fault == "it was wrong"  # the first cause
    robot.supervisor.begin()
    assert robot.send(3) == (DRIVES, 3)
    assert not robot.fault


def test_the_rate_limit_counts_from_the_safe_action():
    robot = Robot(torque_rate_limit=100.0)  # 2 N·m in a period
    assert [robot.send(step)[0] for step in range(3)] == [[2.0, -2.0], [3.0, -4.0], [3.0, -4.0]]
    assert robot.send(-1) == (ZERO, 2)
    for step in (2, 2, 3):  # the same state comes again, and then another one
        assert robot.send(step) == (([2.0, -2.0] if step == 2 else [3.0, -4.0]), step)


def test_the_latest_cause_is_named_where_recovery_is_automatic():
    robot = Robot()
    robot.send(0)
    robot.supervisor.refuse("it was wrong", robot.now)
    robot.send(1, torques=np.array([np.nan, 1.0]))
    assert "the policy's output" in robot.fault


def test_a_clock_that_went_back_lets_any_stamp_follow_once():
    robot = Robot()
    robot.send(500)
    robot.supervisor.forget_time()
    assert robot.send(3) == (DRIVES, 3)
    assert robot.send(2) is None


def test_the_last_command_is_zero():
    robot = Robot()
    assert robot.supervisor.stop() is None
    robot.send(4)
    assert robot.supervisor.stop().control.tolist() == ZERO


def test_far_from_the_training_it_warns_and_then_takes_over(random_distribution, coordinates):
    q = random_distribution(horizon=5, n_x=4, n_u=2)
    robot = Robot(distance_warning=2.0, distance_limit=4.0)
    assert robot.send(0) == (DRIVES, 0)  # there is no distribution yet
    assert robot.supervisor.distance is None
    marginals = TrainingMarginals(q, coordinates(1, 2, 3), 2)
    robot.supervisor.marginals[0] = marginals
    direction = np.array([0.0, 1.0, -1.0, 2.0])
    outwards = q.mean.states[2] + np.linspace(0.0, 30.0, 200)[:, None] * direction
    seen = set()
    for step, state in enumerate(outwards, 1):
        distance = marginals.nearest(state).distance
        assert robot.send(step, state=state) == (ZERO if distance > 4 else DRIVES, step)
        assert robot.supervisor.distance == distance
        assert bool(robot.supervisor.warning) == (2 < distance <= 4)
        assert ("above distance_limit, 4" in robot.fault) == (distance > 4)
        seen.add((distance > 2) + (distance > 4))
    assert seen == {0, 1, 2}
    assert robot.send(300, state=np.full(4, 1e308)) == (ZERO, 300)
    assert robot.send(301, state=q.mean.states[2]) == (DRIVES, 301)


def test_at_first_nothing_is_wrong_and_nothing_is_measured():
    supervisor = Robot().supervisor
    assert supervisor.fault is supervisor.warning is supervisor.distance is None


def test_a_state_is_fresh_for_the_whole_timeout():
    robot = Robot(state_timeout=1.0)
    robot.send(0)
    assert robot.supervisor.watch(robot.now + 1.0) is None
    assert robot.supervisor.watch(robot.now + 1.001) is not None


def test_a_state_beyond_a_limit_of_the_task_leads_to_the_safe_action():
    robot = Robot(broken_limit=lambda state: "it leans." if state[0] > 1.0 else "")
    assert robot.send(0) == (DRIVES, 0)
    assert robot.send(1, state=STATE + 1.0) == (ZERO, 1)
    assert robot.fault == "it leans."
    assert robot.send(2) == (DRIVES, 2)


def test_the_reasons_say_what_was_wrong_and_what_to_do():
    robot = Robot(state_timeout=1.0, max_state_age=0.1)
    robot.send(5)
    robot.send(-100)
    assert robot.fault == "the state's stamp is -2 s, but it must not be < 0."
    robot.send(6, age=3.0)
    assert robot.fault == (
        "the state's stamp differs from the node's clock by 3 s, but max_state_age is 0.1 s; "
        "synchronise the clocks, or set use_sim_time."
    )
    robot.send(7)
    robot.wait(2.0)
    assert robot.fault == (
        "no usable joint_states came for 1 s; check that the simulation, or the robot's driver, is "
        "running."
    )


@pytest.fixture
def marginals(random_distribution, coordinates):
    return TrainingMarginals(random_distribution(horizon=5, n_x=4, n_u=2), coordinates(1, 2, 3), 2)


def test_the_distance_limit_alone_takes_over_just_beyond_it(marginals):
    limit = marginals.nearest(STATE).distance
    robot = Robot(distance_limit=limit)
    robot.supervisor.marginals[0] = marginals
    assert robot.send(0) == (DRIVES, 0)
    assert robot.send(1, state=STATE + np.array([0.0, 50.0, 0.0, 0.0])) == (ZERO, 1)
    assert robot.fault == (
        "the state's Mahalanobis distance from the training marginals is above distance_limit, "
        f"{limit:g}; bring the robot back to where the policy was trained."
    )


def test_the_distance_warning_alone_warns_just_beyond_it(marginals):
    limit = marginals.nearest(STATE).distance
    robot = Robot(distance_warning=limit)
    robot.supervisor.marginals[0] = marginals
    robot.send(0)
    assert robot.supervisor.warning is None
    assert robot.send(1, state=STATE + np.array([0.0, 50.0, 0.0, 0.0])) == (DRIVES, 1)
    assert robot.supervisor.warning == (
        "The state's Mahalanobis distance from the training marginals is above distance_warning, "
        f"{limit:g}."
    )


def test_the_feedback_of_the_nearest_distribution_is_the_safe_action(marginals):
    robot = Robot(safe_action="feedback")
    robot.supervisor.marginals[0] = marginals
    robot.send(0)
    step = marginals.nearest(STATE).step
    expected = np.clip(marginals.feedback(STATE, step), *np.outer([-1.0, 1.0], LIMITS))
    assert robot.send(-1) == (expected.tolist(), 0)
