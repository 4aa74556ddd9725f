# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The walker's model, cost, falls and demonstration."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.ddp.tracking import track
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.policy import Architecture
from vgps_ros.core.records import Trajectory
from vgps_ros.tasks import make_task
from vgps_ros.tasks.walker.simbicon import GAIT, FootLoads, standing, walk
from vgps_ros.tasks.walker.task import walking_from

WALKER = make_task("walker")
LEG = ["hip", "knee", "ankle"]


def test_walker_has_seven_links_nine_degrees_of_freedom_and_six_torques():
    model = WALKER.dynamics.model
    assert (model.nbody - 1, WALKER.dynamics.state_dim, WALKER.dynamics.control_dim) == (7, 18, 6)
    assert model.body_mass.sum() == pytest.approx(70.0)
    legs = [f"{side}_{joint}" for side in ("left", "right") for joint in LEG]
    assert WALKER.actuated_joint_names == legs
    assert WALKER.joint_names == ["root_x", "root_z", "root_pitch", *legs]
    assert WALKER.dynamics.time_step == 0.01


def test_policy_of_ten_units_has_the_papers_246_parameters():
    assert Architecture(WALKER.observation.names, (10,), 6).num_parameters == 246


def test_cost_of_a_step_is_the_papers(rng):
    state, control = rng.standard_normal(18), 50 * rng.standard_normal(6)
    expected = 1e-4 * control @ control + (state[9] - 1.0) ** 2 + (state[1] - 0.93) ** 2
    assert WALKER.cost(state[None], control[None]) == pytest.approx([expected], rel=1e-12)


def test_a_foot_bears_a_load_only_on_the_floor():
    loads = FootLoads(WALKER.dynamics.model)
    state = standing()
    state[1] = 0.915
    assert np.all(loads(state) > 10)
    state[4] = -1.2  # the left knee bends
    assert loads(state)[0] == 0 < loads(state)[1]
    state[1] += 1
    assert_array_equal(loads(state), 0)


@pytest.mark.parametrize("step", [3, 40, 75])
def test_derivatives_through_contact_agree_with_finite_differences(step, finite_differences):
    state, control = WALKER.begin.motion.states[step], WALKER.begin.motion.controls[step]
    assert FootLoads(WALKER.dynamics.model)(state).sum() > 100
    trajectory = Trajectory(np.stack([state, state]), control[None])
    linear, _ = WALKER.dynamics.linearize(trajectory)
    expected = finite_differences(lambda x: WALKER.dynamics.step(x, control), state)
    assert_allclose(linear.f_x[0], expected, atol=2e-3 * np.abs(expected).max())
    expected = finite_differences(lambda u: WALKER.dynamics.step(state, u), control, 1e-4)
    assert_allclose(linear.f_u[0], expected, atol=2e-3 * np.abs(expected).max())


def test_low_hips_and_a_pitched_torso_are_falls():
    states = np.tile(standing(), (5, 1))
    states[1, 1], states[2, 2], states[3, 2], states[4, 1] = 0.64, 1.01, -1.01, 0.66
    assert_array_equal(WALKER.fallen(states), [False, True, True, True, False])


def test_a_rollout_without_torques_falls_and_does_not_survive():
    states, _, _ = WALKER.dynamics.rollouts(
        WALKER.initial_state[None], lambda t, x: np.zeros((1, 6)), 200
    )
    assert not WALKER.survived(states)[0]
    assert WALKER.survived(WALKER.begin.motion.states[None])[0]


def test_demonstration_walks_five_seconds():
    walking = walk(WALKER.dynamics, GAIT, 500)
    assert not WALKER.fallen(walking.states).any()
    assert 0.5 < walking.states[-1, 0] / 5.0 < 1.0


def test_demonstration_goes_on_from_other_starts_too(rng):
    same = walking_from(WALKER.initial_state, WALKER.planned_horizon)
    assert_allclose(same.states, WALKER.begin.motion.states, atol=1e-9)
    start = WALKER.initial_state + WALKER.varied_state_std * rng.standard_normal(18)
    walking = WALKER.begin(WALKER, start, 500, rng).trajectory
    assert_array_equal(walking.states[0], start)
    assert not WALKER.fallen(walking.states).any()
    assert_array_equal(
        WALKER.begin(WALKER, start, 500, rng).trajectory.states, walking.states
    )  # not in mid-stride


def follow(demonstration):
    start = demonstration.states[0]
    return track(WALKER.dynamics, demonstration, start, WALKER.position_names, 1e-6)[0]


def test_demonstration_is_followed_where_open_loop_replay_leaves_it():
    found = follow(WALKER.begin.motion)
    assert_allclose(found.states, WALKER.begin.motion.states, atol=1e-9)


def test_a_demonstration_that_cannot_be_followed_is_reported_with_where_and_by_how_much():
    states = WALKER.begin.motion.states.copy()
    states[100:, 4] += 0.5
    with pytest.raises(DivergenceError, match=r"at step 100 \(1\.00 s\) left_knee/pos.* is 0\.\d"):
        follow(Trajectory(states, WALKER.begin.motion.controls))
