# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The environments keep Gymnasium's rules, and pose the tasks' own problem."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import vgps_ros.tasks.environment  # noqa: F401
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks import make_task

NAMES = {"vgps_ros/Swimmer-v0": "swimmer", "vgps_ros/Walker-v0": "walker"}


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_finds_no_fault(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        check_env(gymnasium.make(name).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_is_a_rollout_of_the_task(name, rng):
    task = make_task(NAMES[name])
    environment = gymnasium.make(name, torque_scale=2.0)
    actions = rng.uniform(-1, 1, (task.horizon, task.dynamics.control_dim))
    rollout = task.dynamics.rollout(task.initial_state, lambda t, _: 2.0 * actions[t], task.horizon)
    observation, _ = environment.reset(options={"exact": True})
    np.testing.assert_array_equal(observation, task.observation(task.initial_state))
    rewards, t, done = [], 0, False
    while not done:
        observation, reward, terminated, truncated, _ = environment.step(actions[t])
        t += 1
        rewards.append(reward)
        np.testing.assert_array_equal(observation, task.observation(rollout.states[t]))
        assert terminated == bool(task.fallen(rollout.states[t]))
        done = terminated or truncated
    costs = task.cost(rollout.states[:t], rollout.controls[:t])
    lying = task.cost.rest(task.horizon - t).sum()
    assert -sum(rewards) == pytest.approx(costs.sum() + lying)
    assert terminated == (name == "vgps_ros/Walker-v0")  # which falls under random torques
    assert truncated == (t == task.horizon)


def test_starts_vary_and_a_seed_repeats_them():
    environment = gymnasium.make("vgps_ros/Swimmer-v0")
    first, other = (environment.reset(seed=seed)[0] for seed in (1, 2))
    again, _ = environment.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3


def test_torques_that_diverge_end_the_episode_with_finite_values():
    environment = gymnasium.make("vgps_ros/Swimmer-v0", torque_scale=1e9)
    environment.reset(seed=3)
    terminated = False
    for _ in range(20):
        observation, reward, terminated, _, _ = environment.step(np.ones(2))
        assert np.isfinite(observation).all()
        assert np.isfinite(reward)
        if terminated:
            break
    assert terminated


def test_a_scale_that_is_not_positive_is_refused():
    with pytest.raises(InvalidInputError, match="torque_scale is 0"):
        gymnasium.make("vgps_ros/Swimmer-v0", torque_scale=0.0)
