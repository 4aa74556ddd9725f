# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Policies that read their last action and former readings: how they are drawn, run and learned."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.marginals import Spread, recollections, sample_histories, state_covariances
from vgps_ros.core.memory import PastInputs
from vgps_ros.core.observation import sample_inputs
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.policy_fit import draw_targets
from vgps_ros.core.records import CostExpansion, Trajectory
from vgps_ros.robot.executed_control import Driver
from vgps_ros.search.methods import check_search, search
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize, optimize_all
from vgps_ros.tasks import make_task
from vgps_ros.tasks.environment import TaskEnvironment
from vgps_ros.tasks.registry import task_file_of

COUNT = 100_000

CART = """
<mujoco>
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody><body>
    <joint name="slide" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="1"/>
  </body></worldbody>
  <actuator><motor name="push" joint="slide" ctrllimited="true" ctrlrange="-20 20"/></actuator>
</mujoco>
"""
TASK = """
model: cart.xml
control_period: 0.05
horizon: 3.0
start: {positions: {slide: 0.5}, std: {position: 0.3, velocity: 0.5}}
cost:
  - {sensor: slide/position, weight: 4.0}
  - {sensor: slide/velocity, weight: 0.4}
  - {control: all, weight: 0.02}
sensor_noise: {slide/position: 0.01}
observe: [slide/position]
search: {hidden_units: [16], iterations: 4, situations: 4}
"""


@pytest.fixture
def cart(tmp_path):
    """Returns a function that makes the cart's task, whose velocity no sensor tells."""

    def make(observe="[slide/position]", history=0):
        text = TASK.replace("[slide/position]", observe) + f"history: {history}\n"
        (tmp_path / "cart.xml").write_text(CART)
        (tmp_path / "task.yaml").write_text(text)
        return make_task(str(tmp_path / "task.yaml"))

    return make


def drawn_policy(task, rng, scale=1.0):
    shape = Architecture(task.observation.names, (5,), task.dynamics.control_dim)
    return GaussianPolicy(shape, scale * rng.standard_normal(shape.num_parameters), np.full(1, 0.5))


@pytest.fixture
def q(random_distribution):
    """A distribution whose marginals are those of its dynamics."""
    q = random_distribution(horizon=5)
    return with_noise(replace(q, gains=0.3 * q.gains), 0.0)


def with_noise(q, std):
    """Returns q with the marginals of dynamics with so much noise."""
    spread = Spread(np.full(4, 0.7), np.full(4, std), np.full(4, np.inf))
    return replace(
        q,
        state_covariances=state_covariances(
            q.linear_dynamics, q.gains, q.control_covariances, spread
        ),
    )


def joint_covariances(q, t):
    """Covariances of (x_{t-2}, x_{t-1}, u_{t-1}) with x_t, in closed form."""
    f = q.linear_dynamics
    closed = f.f_x + f.f_u @ q.gains
    sigma = q.state_covariances
    by_control = q.gains[t - 1] @ sigma[t - 1] @ closed[t - 1].T
    by_control += q.control_covariances[t - 1] @ f.f_u[t - 1].T
    return [
        sigma[t - 2] @ closed[t - 2].T @ closed[t - 1].T,
        sigma[t - 1] @ closed[t - 1].T,
        by_control,
    ]


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_histories_are_drawn_jointly_with_their_states(q, rng, noise):
    q = with_noise(q, noise)
    drawn = sample_histories(q, COUNT, 2, rng)
    now, before, earlier = drawn.states
    for t in range(2, 5):
        assert_allclose(np.cov(now[:, t].T), q.state_covariances[t], rtol=0.1, atol=0.2)
        for found, expected in zip(
            (earlier, before, drawn.controls), joint_covariances(q, t), strict=True
        ):
            crossed = found[:, t].T @ now[:, t] / COUNT
            size = np.sqrt(np.outer(found[:, t].var(axis=0), now[:, t].var(axis=0)))
            assert np.all(np.abs(crossed - expected) < 0.03 * size)
    assert_array_equal(earlier[:, 0], now[:, 0])  # before x_1 all was as in it
    assert_array_equal(earlier[:, 1], before[:, 1])


def test_what_a_state_tells_of_former_steps_is_the_regression_on_it(q):
    by_states, by_controls = recollections(q, 2)
    for t in range(2, 5):
        inverse = np.linalg.inv(q.state_covariances[t])
        expected = [c @ inverse for c in joint_covariances(q, t)]
        found = by_states[1, t], by_states[0, t], by_controls[t]
        for each, one in zip(found, expected, strict=True):
            assert_allclose(each, one, atol=1e-3)
    assert_allclose(by_states[:, 0], np.broadcast_to(np.eye(4), (2, 4, 4)), atol=1e-5)
    assert not by_controls[0].any()


def test_a_narrowed_marginal_keeps_its_width_and_the_history_goes_with_it(q, rng):
    sigma = q.state_covariances.copy()
    scale = np.array([0.1, 1.0, 1.0, 1.0])
    sigma[3] *= np.outer(scale, scale)
    drawn = sample_histories(replace(q, state_covariances=sigma), COUNT, 1, rng)
    assert_allclose(np.cov(drawn.states[0][:, 3].T), sigma[3], rtol=0.1, atol=0.05)
    whole = sample_histories(q, COUNT, 1, rng)
    ratio = drawn.states[1][:, 3].std(axis=0) / whole.states[1][:, 3].std(axis=0)
    assert_allclose(ratio, scale, rtol=0.02)


def remembering(observation, history, limit=np.inf):
    limits = np.full(2, -limit), np.full(2, limit)
    past = PastInputs(observation.names, history, ("a", "b"), np.array([0.1, -0.2]), limits)
    return replace(observation, past=past)


class NoCost:
    """c = 0, of states of four numbers and two controls."""

    def values(self, trajectory):
        return np.zeros(trajectory.horizon)

    def expand(self, trajectory):
        shapes = [(), (4,), (2,), (4, 4), (2, 2), (2, 4)]
        return CostExpansion(*(np.zeros((trajectory.horizon, *shape)) for shape in shapes))


def test_the_policy_cost_moves_the_memory_with_the_state(
    q, coordinates, random_policy, rng, finite_differences
):
    """c_x is the gradient along a change of x_t and of what q did before it."""
    observation = remembering(coordinates(0, 2), 2)
    policy = random_policy(observed=observation.names)
    cost = PolicyCost.of(ScaledCost(NoCost(), 1.0), policy, observation, q, 4, rng)
    (by_states, by_controls), t = recollections(q, 2), 3

    def value(change):
        states, controls = q.mean.states.copy(), q.mean.controls.copy()
        states[t] += change
        for lag in (1, 2):
            states[t - lag] += by_states[lag - 1, t] @ change
        controls[t - 1] += by_controls[t] @ change
        return cost.values(Trajectory(states, controls))[t]

    found = cost.expand(q.mean)
    assert_allclose(found.c, cost.values(q.mean), rtol=1e-12)
    assert_allclose(found.c_x[t], finite_differences(value, np.zeros(4)), atol=1e-6)


@pytest.mark.parametrize("late", [0.0, 0.5])
def test_targets_read_what_was_before(q, coordinates, rng, late):
    """In samples of q the newest reading less what the dynamics make of the former is noise."""
    observation = remembering(coordinates(0, 1, 2, 3), 1)
    targets = draw_targets([q], observation, 20_000, rng, late)
    assert observation.names[4:] == (
        *(f"past/1/x{i}" for i in range(4)),
        *("last_action/a", "last_action/b"),
    )
    inputs = targets.inputs.reshape(-1, 5, 10)
    assert_array_equal(inputs[:, 0, 4:8], inputs[:, 0, :4])
    if not late:
        assert_array_equal(inputs[:, 0, 8:], np.tile([0.1, -0.2], (len(inputs), 1)))
        f, t = q.linear_dynamics, 3
        before = inputs[:, t, 4:8] - q.mean.states[t - 1]
        acted = inputs[:, t, 8:] - q.mean.controls[t - 1]
        after = before @ f.f_x[t - 1].T + acted @ f.f_u[t - 1].T
        assert_allclose(after, inputs[:, t, :4] - q.mean.states[t], atol=1e-9)


def test_without_a_memory_the_same_samples_are_drawn(q, coordinates):
    observation = coordinates(0, 1)
    deviations, inputs = sample_inputs(q, observation, 3, np.random.default_rng(0))
    assert_array_equal(inputs, observation(q.mean.states[:-1] + deviations))
    assert observation.now is observation


@pytest.mark.parametrize("lag", [0, 2])
def test_every_executor_remembers_the_same(cart, rng, lag):
    """The compiled loop, the law of a driver, and the samples of an executed motion agree."""
    task = cart("[slide/position, last_action]", history=2)
    policy, steps = drawn_policy(task, rng, 5.0), 40
    starts = task.initial_state + np.array([[0.0, 0.0], [0.3, -1.0]])
    noise = rng.standard_normal((2, steps, 1))
    misread = 0.1 * rng.standard_normal((2, steps, 1))
    states, controls = task.dynamics.execute(
        policy, task.observation, starts, noise, lag=lag, sensor_noise=misread
    )
    driver = Driver.of(task.observation, policy)
    assert driver.observation.names == ("slide/position",)
    law, read = driver.new_law(), []

    def control_law(t, x):
        read.append(driver.observation(x))
        return law(read[max(0, t - lag)] + misread[:, t], noise[:, t])

    same_states, same_controls, _ = task.dynamics.rollouts(starts, control_law, steps)
    assert_array_equal(states, same_states)
    assert_array_equal(controls, same_controls)
    assert np.abs(controls).max() == 20.0  # what is remembered is within the limits
    if not lag:
        silent = task.dynamics.execute(policy, task.observation, starts, noise)
        inputs = task.observation.along(silent[0][:, :-1], silent[1])
        expected = np.clip(policy.mean(inputs) + noise, -20.0, 20.0)
        assert_allclose(silent[1], expected, atol=1e-9)
        assert_array_equal(inputs[:, 0, 1:], np.c_[inputs[:, 0, :1], inputs[:, 0, :1], [0, 0]])
        assert_array_equal(inputs[:, 5, 1:3], states_of(silent[0], (4, 3)))


def states_of(states, steps):
    return np.stack([states[:, t, 0] for t in steps], axis=1)


def test_an_environment_observes_what_policies_read(cart, tmp_path):
    observation = cart("[slide/position, last_action]", history=2).observation
    environment = TaskEnvironment(str(tmp_path / "task.yaml"), torque_scale=10.0)
    actions = np.array([[0.3], [-3.0], [0.5]])
    for _ in range(2):  # a new episode forgets the last one
        seen = [environment.reset(options={"exact": True})[0]]
        states = [environment.state]
        for action in actions:
            seen.append(environment.step(action)[0])
            states.append(environment.state)
        controls = np.concatenate([10.0 * actions, [[0.0]]])
        assert_array_equal(seen, observation.along(np.array(states), controls))


def trained_cost(task, rng):
    """The mean cost of a policy that was learned, from other starts, with the sensors' noise."""
    settings = search_settings(task)
    *_, found = search("vgps", task, settings, 0, partial(optimize_all, task))
    starts = task.initial_state + task.initial_std * rng.standard_normal((100, 2))
    misread = 0.01 * rng.standard_normal((100, task.horizon, 1))
    if "slide/velocity" in task.observation.names:
        misread = np.zeros((100, task.horizon, 2))
    silent = np.zeros((100, task.horizon, 1))
    states, controls = task.dynamics.execute(
        found.policy, task.observation, starts, silent, sensor_noise=misread
    )
    return task.rollout_costs(states, controls).mean()


def test_a_history_stands_in_for_velocities_that_nothing_measures(cart):
    """Positions alone cannot damp a cart. Three of them cost little more than its whole state."""
    blind, history, whole = (
        trained_cost(cart(*each), np.random.default_rng(0))
        for each in (
            ("[slide/position]", 0),
            ("[slide/position, last_action]", 3),
            ("[slide/position, slide/velocity]", 0),
        )
    )
    assert history < 1.15 * whole < 0.4 * blind


def test_a_mirror_exchanges_former_readings_and_actions(tmp_path):
    file = task_file_of("quadruped")
    text = file.read_text().replace("turning, commands", "turning, last_action, commands")
    (tmp_path / "task.yaml").write_text(text + "history: 1\n")
    (tmp_path / "quadruped.xml").write_text((file.parent / "quadruped.xml").read_text())
    task = make_task(str(tmp_path / "task.yaml"))
    names, mirror = task.observation.names, task.augmentation.mirror
    for name, other, sign in (
        ("past/1/front_left_hip/position", "past/1/front_right_hip/position", -1.0),
        ("past/1/up/y", "past/1/up/y", -1.0),
        ("last_action/hind_left_hip", "last_action/hind_right_hip", -1.0),
        ("last_action/hind_left_thigh", "last_action/hind_right_thigh", 1.0),
    ):
        i = names.index(name)
        assert (names[mirror.inputs[i]], mirror.input_signs[i]) == (other, sign)
    noise = dict(zip(names, task.augmentation.noise, strict=True))
    assert noise["past/1/turning/z"] == noise["turning/z"] == 0.05
    assert noise["last_action/hind_left_hip"] == 0.0


def test_other_methods_refuse_a_memory(cart):
    task = cart(history=1)
    with pytest.raises(InvalidInputError, match="read former steps, which dagger does not draw"):
        check_search("dagger", task, search_settings(task), 0)


def test_the_q_step_sees_through_the_memory_to_the_state(cart):
    """A law of the velocity is the same for q, read or told by two positions and an action."""
    k_x, k_v, period = 3.0, 2.0, 0.05
    # Of five steps of 0.01 s: x_t - x_{t-1} = 0.05 v_t - 0.001 u_{t-1}.
    tellers = {
        (("[slide/position, slide/velocity]", 0)): [-k_x, -k_v],
        (("[slide/position, last_action]", 1)): [
            *(-k_x - k_v / period, k_v / period, -0.001 * k_v / period)
        ],
    }
    found = []
    for teller, weights in tellers.items():
        task = cart(*teller)
        shape = Architecture(task.observation.names, (), 1, output_bias=False)
        policy = GaussianPolicy(shape, np.array(weights), np.full(1, 0.5))
        first = optimize(task, first_request(task, 0, 20)).distribution
        request = replace(first_request(task, 0, 5), previous=first, policy=policy)
        found.append(optimize(task, request).distribution)
    read, told = found
    assert_allclose(told.mean.controls, read.mean.controls, atol=1e-3)
    assert_allclose(told.gains[1:], read.gains[1:], atol=1e-2)
    assert np.abs(read.gains[1:, 0, 1]).min() > 1.0
