# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A demonstration is followed with feedback, or it is said where it is left."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.core.ddp.conftest import LqProblem
from vgps_ros.core.ddp.tracking import track
from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.records import LinearDynamics

HORIZON = 30
NAMES = ["hip", "knee"]


@dataclass(frozen=True)
class Unstable(LqProblem):
    """Deviations of both positions double with each step, unless feedback takes them back."""

    space = StateSpace(4)
    control_dim = 2
    time_step = 0.1


@pytest.fixture
def unstable():
    f_x = np.tile(np.diag([2.0, 2.0, 0.5, 0.5]), (HORIZON, 1, 1))
    f_u = np.tile(np.eye(4, 2), (HORIZON, 1, 1))
    cost = np.tile(np.eye(6), (HORIZON, 1, 1)), np.zeros((HORIZON, 6))
    return Unstable(LinearDynamics(f_x, f_u), *cost)


@pytest.fixture
def demonstration(unstable, rng):
    """A motion that stays within bounds by its own torques."""
    pushes = 0.1 * rng.standard_normal((HORIZON, 2))
    return unstable.rollout(np.zeros(4), lambda t, x: pushes[t] - 1.9 * x[:, :2], HORIZON)


def test_feedback_keeps_to_a_demonstration_from_which_its_torques_alone_diverge(
    unstable, demonstration
):
    start = demonstration.states[0] + [1e-3, -1e-3, 0.0, 0.0]
    alone = unstable.rollout(start, lambda t, _: demonstration.controls[t], HORIZON)
    assert np.abs(alone.states[-1] - demonstration.states[-1]).max() > 1e5
    followed, steps = track(unstable, demonstration, start, NAMES, tolerance=2e-3)
    assert_allclose(followed.states[-1], demonstration.states[-1], atol=1e-6)
    two_later = np.abs(followed.states[2] - demonstration.states[2]).max()
    assert two_later < 0.05e-3  # the least torques that do not diverge would leave a quarter
    assert steps == (7 + 3) * HORIZON


def test_the_feedback_is_that_of_the_regulator_s_riccati_recursion(unstable, demonstration):
    """With μ on the next state's deviation, as in the backward pass, in gains alone."""
    V, gains = np.zeros((4, 4)), np.empty((HORIZON, 2, 4))
    for t in reversed(range(HORIZON)):
        A, B = unstable.linear.f_x[t], unstable.linear.f_u[t]
        Q_xx, Q_ux, Q_uu = 2 * np.eye(4) + A.T @ V @ A, B.T @ V @ A, 2e-4 * np.eye(2) + B.T @ V @ B
        K = -np.linalg.solve(Q_uu + 0.1 * B.T @ B, Q_ux + 0.1 * B.T @ A)
        V = Q_xx + K.T @ Q_uu @ K + K.T @ Q_ux + Q_ux.T @ K
        gains[t] = K
    start = demonstration.states[0] + [0.1, -0.2, 0.3, 0.4]
    (expected,) = unstable.follow_each(start, [demonstration], gains)
    followed, _ = track(unstable, demonstration, start, NAMES, tolerance=1.0)
    assert_allclose(followed.controls, expected.controls, rtol=0, atol=1e-9)


def test_a_demonstration_that_is_left_is_refused_with_the_place_and_the_joint(
    unstable, demonstration
):
    demonstration.states[3, 1] += 0.5
    sentence = (
        r"at step 3 \(0\.30 s\) knee is 0\.5 away from it, but at most 0\.1 is allowed; check"
    )
    with pytest.raises(DivergenceError, match=sentence):
        track(unstable, demonstration, demonstration.states[0], NAMES, tolerance=0.1)
