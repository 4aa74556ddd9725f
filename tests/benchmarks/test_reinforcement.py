# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Goals are what they say, and a peer is driven, looked at and ended as it should be."""

import tempfile

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import VecNormalize

import vgps_ros.tasks.environment  # noqa: F401  registers them
from benchmarks import controller_peer, stable_baselines
from benchmarks.reinforcement import Goal, Stopwatch, learn, walking_goal
from vgps_ros.core.records import Trajectory
from vgps_ros.tasks import make_task

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def walker():
    return make_task("walker")


@pytest.fixture(scope="module")
def quadruped():
    return make_task("quadruped")


@pytest.fixture(autouse=True)
def own_temporary_folder(tmp_path, monkeypatch):
    """Stable-Baselines3 leaves its logs where temporary files go."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


@pytest.mark.parametrize(
    ("speed", "upright", "lacking"), [(1.0, 1.0, 0.0), (0.25, 1.0, 5.0), (1.0, 0.3, 7.0)]
)
def test_walking_needs_speed_and_no_fall(walker, speed, upright, lacking):
    goal = walking_goal(walker)
    states = np.tile(walker.initial_state, (goal.horizon + 1, 1))
    time = np.arange(goal.horizon + 1) * walker.dynamics.time_step
    states[:, 0] += speed * time
    states[time >= upright * 10.0 + 1e-9, 1] = 0.3  # hips [m]
    motion = Trajectory(states, np.zeros((goal.horizon, walker.dynamics.control_dim)))
    assert goal.figure(motion) == pytest.approx(lacking, abs=2 * walker.dynamics.time_step)
    assert (goal.figure(motion) <= goal.bound) == (lacking == 0.0)


def test_a_rollout_that_diverges_is_no_success(swimmer):
    goal = Goal("cost", 50, swimmer.trajectory_cost, np.inf)
    assert goal.measure(swimmer, lambda _, x: np.full((1, 2), 1e9)) == np.inf
    assert np.isfinite(goal.measure(swimmer, lambda _, x: np.zeros((1, 2))))


@pytest.mark.parametrize("algorithm", [PPO, SAC])
def test_a_peer_ends_at_its_goal_or_at_its_limit(swimmer, algorithm, tmp_path):
    cost = swimmer.trajectory_cost
    at_once = Goal("cost", 50, cost, 1e9)
    there = stable_baselines.learn(algorithm, swimmer, at_once, 5, limit=600.0)
    assert there.reached
    assert there.simulator_steps == there.policy_steps
    assert there.policy_steps >= 2048 * swimmer.dynamics.substeps
    never = Goal("cost", 50, cost, 0.0)
    given_up = stable_baselines.learn(algorithm, swimmer, never, None, limit=there.seconds)
    assert not given_up.reached
    assert given_up.seconds >= there.seconds
    assert not list(tmp_path.glob("SB3-*"))


@pytest.mark.parametrize(("algorithm", "steps"), [(PPO, 2048), (SAC, 300)])
def test_a_peers_policy_is_judged_on_the_environment_that_it_learns_in(swimmer, algorithm, steps):
    """The rollout of the law, normalised and scaled, is the environment's own episode."""
    environment = stable_baselines.environments(algorithm, swimmer)
    model = algorithm("MlpPolicy", environment, seed=3, device="cpu")
    model.learn(total_timesteps=steps)
    law = stable_baselines.control_law(model, swimmer)
    rollout = swimmer.dynamics.rollout(swimmer.initial_state, law, 20)
    scale = stable_baselines.TORQUE_SCALE["swimmer"]
    episode = gymnasium.make("vgps_ros/Swimmer-v0", torque_scale=scale)
    observation, _ = episode.reset(options={"exact": True})
    normalizer = model.get_vec_normalize_env()
    for state in rollout.states[1:]:
        seen = normalizer.normalize_obs(observation) if normalizer else observation
        action, _ = model.predict(seen, deterministic=True)
        observation, *_ = episode.step(action)
        np.testing.assert_allclose(episode.unwrapped.state, state, rtol=0, atol=1e-9)


def test_an_actor_becomes_a_policy_of_ours_with_the_same_targets(quadruped, tmp_path):
    robots = VecNormalize(controller_peer.Robots(quadruped, 3, 0.25, 0.05), gamma=0.99)
    policy_kwargs = {"net_arch": list(controller_peer.HIDDEN)}
    model = PPO("MlpPolicy", robots, n_steps=2, batch_size=512, policy_kwargs=policy_kwargs)
    model.learn(2048)
    normalised = robots.reset()
    policy = controller_peer.as_policy(model, quadruped)
    actions = model.predict(normalised, deterministic=True)[0]
    wanted = controller_peer.targets(quadruped, actions)
    np.testing.assert_allclose(policy.mean(robots.unnormalize_obs(normalised)), wanted, atol=1e-5)


def test_robots_side_by_side_are_the_task_s_own_robot(quadruped):
    """A step is one of the task's dynamics, and its cost the task's in the robot's context."""
    robots = controller_peer.Robots(quadruped, 3, 0.25, 0.05)
    robots.reset()
    before, context = robots.states.copy(), robots.context()
    actions = np.random.default_rng(1).normal(0.0, 0.3, (len(before), 12))
    robots.step_async(actions)
    _, rewards, done, _ = robots.step_wait()
    controls = np.clip(
        controller_peer.targets(quadruped, actions), *quadruped.dynamics.control_limits
    )
    pushed = np.any(robots.pushed != before, axis=1)
    kept = [i for i in range(len(before)) if not (pushed[i] or done[i])][:5]
    for i in kept:
        after = quadruped.dynamics.step(before[i], controls[i])
        np.testing.assert_allclose(robots.states[i], after, atol=1e-9)
    alone = [
        quadruped.in_context(context[i : i + 1]).cost(before[i : i + 1], controls[i : i + 1])[0]
        for i in kept
    ]
    reward = rewards[kept] / quadruped.dynamics.time_step
    obeyed = reward + 0.05 * np.array(alone)
    assert np.all(reward >= 0.0)  # a fall never pays
    assert np.all((obeyed > 0.0) & ((obeyed < 1.5) | (reward == 0.0)))
    assert 0 < pushed.sum() < 20


def test_the_clock_of_a_robot_at_rest_turns_after_a_push(quadruped):
    robots = controller_peer.Robots(quadruped, 3, 0.25, 0.05)
    robots.reset()
    robots._commands[:] = 0.0
    assert not robots.context().any()  # all clocks stand
    robots.states[0, quadruped.dynamics.model.nq + 3] = 3.0  # it turns about a level axis [rad/s]
    robots.step_async(np.zeros((len(robots.states), 12)))
    robots.step_wait()
    robots._commands[:] = 0.0
    assert np.linalg.norm(robots.context()[0]) == pytest.approx(1.0)


def test_our_search_stops_at_its_goal(swimmer):
    goal = Goal("cost", 50, swimmer.trajectory_cost, np.inf)
    ours = learn(swimmer, goal, 2, Stopwatch())
    assert ours.reached
    assert ours.policy_steps == 0
    assert ours.simulator_steps > 80 * swimmer.horizon  # the initial solve alone
