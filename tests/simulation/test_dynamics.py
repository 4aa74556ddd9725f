# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
from itertools import islice

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import ACTIVATIONS, Architecture, GaussianPolicy
from vgps_ros.core.records import Trajectory
from vgps_ros.robot.executed_control import ExecutedPolicy
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import cyclic_positions
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks import make_task


@pytest.fixture
def points(rng):
    """Five unrelated states and controls, as a trajectory."""
    return Trajectory(rng.uniform(-1, 1, (6, 10)), rng.uniform(-30, 30, (5, 2)))


def test_step_is_the_simulators(swimmer, points):
    model, state, control = swimmer.dynamics.model, points.states[0], points.controls[0]
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.ctrl = state[:5], state[5:], control
    mujoco.mj_step(model, data, 3)
    stepped = Dynamics(model, substeps=3).step(state, control)
    assert_array_equal(stepped, np.concatenate([data.qpos, data.qvel]))
    assert Dynamics(model, substeps=3).time_step == pytest.approx(0.06)


@pytest.mark.parametrize("substeps", [1, 2, 3])
def test_derivatives_agree_with_finite_differences_of_step(
    swimmer, points, finite_differences, substeps
):
    dynamics = Dynamics(swimmer.dynamics.model, substeps=substeps)
    linear, _ = dynamics.linearize(points)
    for t in range(points.horizon):
        x, u = points.states[t], points.controls[t]
        f_x = finite_differences(lambda x, u=u: dynamics.step(x, u), x, eps=1e-5)
        f_u = finite_differences(lambda u, x=x: dynamics.step(x, u), u, eps=1e-3)
        assert_allclose(linear.f_x[t], f_x, rtol=0, atol=5e-7)
        assert_allclose(linear.f_u[t], f_u, rtol=0, atol=5e-7)


def centred_differences(dynamics, trajectory):
    """MuJoCo's own, by the chain rule over the simulator steps of one control."""
    model, n_x, n_u = dynamics.model, dynamics.space.state_dim, dynamics.control_dim
    data = mujoco.MjData(model)
    for state, control in zip(trajectory.states, trajectory.controls, strict=False):
        data.qpos, data.qvel, data.ctrl = state[: n_x // 2], state[n_x // 2 :], control
        data.qacc_warmstart = 0.0
        f_x, f_u, a, b = (
            np.eye(n_x),
            np.zeros((n_x, n_u)),
            np.zeros((n_x, n_x)),
            np.zeros((n_x, n_u)),
        )
        for substep in range(dynamics.substeps):
            if substep:
                mujoco.mj_step(model, data)
            mujoco.mjd_transitionFD(model, data, 1e-6, True, a, b, None, None)
            f_x, f_u = a @ f_x, a @ f_u + b
        yield np.hstack([f_x, f_u])


@pytest.mark.parametrize(
    ("name", "steps", "error"), [("swimmer", 100, 1e-6), ("walker", 460, 1e-4)]
)
def test_derivatives_along_a_motion_are_those_of_the_simulators_centred_differences(
    name, steps, error, rng
):
    """Relative to the largest entry; where contacts switch, centred differences are no measure."""
    task = make_task(name)
    trajectory = task.begin(task, task.initial_state, steps, rng).trajectory
    linear, _ = task.dynamics.linearize(trajectory)
    errors = []
    for t, expected in enumerate(centred_differences(task.dynamics, trajectory)):
        found = np.hstack([linear.f_x[t], linear.f_u[t]])
        errors.append(np.abs(found - expected).max() / np.abs(expected).max())
    assert np.quantile(errors, 0.9) < error


@pytest.mark.parametrize(("name", "cyclic"), [("swimmer", [0, 1]), ("walker", [0])])
def test_nothing_depends_on_cyclic_positions_but_those_positions(name, cyclic, rng):
    dynamics = make_task(name).dynamics
    assert cyclic_positions(dynamics.model) == cyclic
    n_dx = dynamics.space.tangent_dim
    states = rng.uniform(-0.3, 0.3, (6, dynamics.space.state_dim))
    points = Trajectory(states, rng.uniform(-30, 30, (5, dynamics.control_dim)))
    linear, _ = dynamics.linearize(points)
    for f_x, expected in zip(linear.f_x, centred_differences(dynamics, points), strict=True):
        assert_allclose(expected[:, cyclic], np.eye(n_dx)[:, cyclic], rtol=0, atol=1e-6)
        assert_array_equal(f_x[:, cyclic], np.eye(n_dx)[:, cyclic])


def test_at_rest_where_drag_has_a_kink_differences_are_centred(swimmer):
    rest = Trajectory(np.zeros((2, 10)), np.zeros((1, 2)))
    linear, _ = swimmer.dynamics.linearize(rest)
    (expected,) = centred_differences(swimmer.dynamics, rest)
    assert_allclose(np.hstack([linear.f_x[0], linear.f_u[0]]), expected, rtol=0, atol=1e-6)


def test_following_is_a_rollout_of_that_feedback(swimmer, rng):
    dynamics, gains = swimmer.dynamics, rng.standard_normal((20, 2, 10))
    nominal = Trajectory(rng.uniform(-0.1, 0.1, (21, 10)), rng.uniform(-30, 30, (20, 2)))
    start = np.full(10, 0.1)
    (followed,) = dynamics.follow_each(start, [nominal], gains)
    rollout = dynamics.rollout(
        start, lambda t, x: nominal.controls[t] + (x - nominal.states[t]) @ gains[t].T, 20
    )
    assert_allclose(followed.states, rollout.states, rtol=1e-9, atol=1e-12)
    assert_allclose(followed.controls, rollout.controls, rtol=1e-9)


@pytest.mark.parametrize("taken", [1, 3, 5])
def test_several_are_followed_as_each_alone_whatever_the_number_of_threads(swimmer, rng, taken):
    gains, start = rng.standard_normal((20, 2, 10)), np.full(10, 0.1)
    nominals = [
        Trajectory(rng.uniform(-0.1, 0.1, (21, 10)), rng.uniform(-30, 30, (20, 2)))
        for _ in range(5)
    ]
    alone = [
        next(swimmer.dynamics.follow_each(start, [nominal], gains)) for nominal in nominals[:taken]
    ]
    for threads in (1, 2, 3, 8):
        dynamics = Dynamics(swimmer.dynamics.model, threads=threads)
        found = list(islice(dynamics.follow_each(start, nominals, gains), taken))
        assert_array_equal([t.states for t in found], [t.states for t in alone])
        assert_array_equal([t.controls for t in found], [t.controls for t in alone])


@pytest.mark.parametrize("control", [np.nan, 1e8, 1e12])
def test_what_diverges_while_it_follows_is_nan_from_there_on(swimmer, control):
    nominal = Trajectory(np.zeros((11, 10)), np.full((10, 2), 10.0))
    nominal.controls[4] = control
    (followed,) = swimmer.dynamics.follow_each(np.zeros(10), [nominal], np.zeros((10, 2, 10)))
    assert np.isfinite(followed.states[:5]).all()
    assert np.isnan(followed.states[5:]).all()
    assert_array_equal(followed.controls[4], nominal.controls[4])
    assert np.isnan(followed.controls[5:]).all()


def test_number_of_threads_does_not_change_a_bit(swimmer, points):
    (one, steps), *others = (
        Dynamics(swimmer.dynamics.model, threads=n).linearize(points) for n in (1, 2, 3, 8)
    )
    for linear, taken in others:
        assert taken == steps
        assert_array_equal(linear.f_x, one.f_x)
        assert_array_equal(linear.f_u, one.f_u)


def test_rollouts_side_by_side_equal_single_ones(swimmer, rng):
    dynamics, gains = swimmer.dynamics, rng.standard_normal((2, 10))
    starts = rng.uniform(-0.5, 0.5, (4, 10))

    def law(t, x):
        # Elementwise: a matrix product may round differently for other numbers of rows.
        return 20.0 * np.sin(0.3 * t) + (x[:, None] * gains).sum(-1)

    states, controls, _ = dynamics.rollouts(starts, law, 25)
    assert states.shape == (4, 26, 10)
    for i, start in enumerate(starts):
        single = dynamics.rollout(start, law, 25)
        assert_array_equal(states[i], single.states)
        assert_array_equal(controls[i], single.controls)


def test_rollout_repeats_step_under_its_law(swimmer, rng):
    dynamics, gains = swimmer.dynamics, rng.standard_normal((2, 10))
    trajectory = dynamics.rollout(np.full(10, 0.1), lambda t, x: t + x @ gains.T, 10)
    for t in range(10):
        x, u = trajectory.states[t], trajectory.controls[t]
        assert_allclose(u, t + gains @ x, rtol=1e-12)
        assert_array_equal(trajectory.states[t + 1], dynamics.step(x, u))


def test_earlier_steps_leave_no_trace(swimmer, points):
    dynamics, state, control = swimmer.dynamics, points.states[0], points.controls[0]
    first = dynamics.step(state, control)
    dynamics.step(points.states[1], 1e3 * points.controls[1])
    assert_array_equal(dynamics.step(state, control), first)


def test_diverged_rollout_is_nan_from_there_on_and_others_unaffected(swimmer):
    dynamics, starts = swimmer.dynamics, np.zeros((3, 10))

    def law(t, x, explodes=True):
        controls = np.full((len(x), 2), 10.0)
        if t == 4 and explodes:
            controls[1] = 1e8
        return controls

    states, controls, _ = dynamics.rollouts(starts, law, 12)
    calm, *_ = dynamics.rollouts(starts, lambda t, x: law(t, x, False), 12)
    assert_array_equal(states[1, :5], calm[1, :5])
    assert np.isnan(states[1, 5:]).all()
    assert controls[1, 4, 0] == 1e8
    assert np.isnan(controls[1, 5:]).all()
    assert_array_equal(states[[0, 2]], calm[[0, 2]])


def test_rollout_from_a_state_that_is_not_finite_is_nan(swimmer):
    starts = np.zeros((2, 10))
    starts[0, 3] = np.nan
    states, *_ = swimmer.dynamics.rollouts(starts, lambda t, x: np.zeros((2, 2)), 3)
    assert np.isnan(states[0, 1:]).all()
    assert np.isfinite(states[1]).all()


@pytest.mark.parametrize("control", [np.nan, np.inf, 1e12])
def test_control_that_the_simulator_would_drop_makes_a_rollout_diverge(swimmer, control):
    """MuJoCo replaces such controls by zero; the rollout would go on as if nothing had been."""
    trajectory = swimmer.dynamics.rollout(np.full(10, 0.3), lambda t, x: np.full(2, control), 3)
    assert np.isnan(trajectory.states[1:]).all()


def test_the_model_that_is_handed_in_stays_as_it_is(swimmer):
    model = mujoco.MjModel.from_xml_string(swimmer.mjcf)
    before = model.opt.disableflags
    assert Dynamics(model).model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert model.opt.disableflags == before


@pytest.fixture
def observation(swimmer):
    """Numbers of the state, and one of the centre of mass."""
    names = ["root_y/position", "back_joint/position", "root_yaw/velocity", "velocity/y"]
    return Observation(Readings(swimmer.dynamics.simulations, names))


def policy_of(observation, hidden, rng, *options, **biases):
    shape = Architecture(observation.names, hidden, 2, *options, **biases)
    return GaussianPolicy(shape, rng.standard_normal(shape.num_parameters), np.ones(2))


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize(("hidden", "biases"), [((), False), ((4,), True), ((5, 3), False)])
def test_executing_a_policy_is_a_rollout_of_its_mean_and_noise(
    swimmer, observation, rng, activation, hidden, biases
):
    policy = policy_of(observation, hidden, rng, activation, hidden_bias=biases, output_bias=biases)
    starts, noise = rng.uniform(-0.5, 0.5, (3, 10)), rng.standard_normal((3, 20, 2))
    states, controls = swimmer.dynamics.execute(policy, observation, starts, noise)
    expected = swimmer.dynamics.rollouts(
        starts, lambda t, x: policy.mean(observation(x)) + noise[:, t], 20
    )
    assert_allclose(states, expected[0], rtol=1e-9, atol=1e-12)
    assert_allclose(controls, expected[1], rtol=1e-9, atol=1e-12)


def test_number_of_threads_does_not_change_an_execution_and_one_that_diverges_no_other(
    swimmer, observation, rng
):
    policy = policy_of(observation, (3,), rng)
    starts, noise = np.zeros((3, 10)), rng.standard_normal((3, 12, 2))
    calm, _ = swimmer.dynamics.execute(policy, observation, starts, noise)
    noise[1, 4] = 1e8
    for threads in (1, 2, 5):
        dynamics = Dynamics(swimmer.dynamics.model, threads=threads)
        states, controls = dynamics.execute(policy, observation, starts, noise)
        assert_array_equal(states[[0, 2]], calm[[0, 2]])
        assert_array_equal(states[1, :5], calm[1, :5])
        assert np.isnan(states[1, 5:]).all()
        assert np.isfinite(controls[1, 4]).all()
        assert np.isnan(controls[1, 5:]).all()


def test_a_policy_of_another_robot_is_not_executed(swimmer, observation, rng):
    other = Observation(Readings(swimmer.dynamics.simulations, observation.names[:-1]))
    policy = policy_of(other, (3,), rng)
    with pytest.raises(InvalidInputError, match=r"policies read root_y/pos.*velocity/y;"):
        swimmer.dynamics.execute(policy, observation, np.zeros((1, 10)), np.zeros((1, 5, 2)))


def told_with(observation, context):
    return Observation.of(observation.readings, ["b"], ["a", "b"]).within(context)


def test_each_rollout_that_is_executed_is_told_its_own_context(swimmer, observation, rng):
    starts, noise = rng.uniform(-0.5, 0.5, (3, 10)), rng.standard_normal((3, 20, 2))
    context = rng.standard_normal((3, 25, 2))  # longer than the motion
    each = told_with(observation, context)
    policy = policy_of(each, (4,), rng)
    states, controls = swimmer.dynamics.execute(policy, each, starts, noise)
    expected = swimmer.dynamics.rollouts(
        starts,
        lambda t, x: (
            policy.mean(each.within(context[:, t : t + 1])(x[:, None]))[:, 0] + noise[:, t]
        ),
        20,
    )
    assert_allclose(states, expected[0], rtol=1e-9, atol=1e-12)
    assert_allclose(controls, expected[1], rtol=1e-9, atol=1e-12)
    for i in range(3):
        alone = swimmer.dynamics.execute(
            policy, each.within(context[i]), starts[i : i + 1], noise[i : i + 1]
        )
        assert_array_equal(alone[0][0], states[i])
        assert_array_equal(alone[1][0], controls[i])


@pytest.mark.parametrize("lag", [0, 1, 3])
def test_a_policy_may_read_late_and_wrongly(swimmer, observation, rng, lag):
    starts, noise = rng.uniform(-0.5, 0.5, (3, 10)), rng.standard_normal((3, 15, 2))
    context, misread = rng.standard_normal((15, 2)), 0.1 * rng.standard_normal((3, 15, 4))
    told = told_with(observation, context)
    policy = policy_of(told, (4,), rng)
    states, controls = swimmer.dynamics.execute(
        policy, told, starts, noise, lag=lag, sensor_noise=misread
    )
    execute, low, high = ExecutedPolicy(policy).mean, *swimmer.dynamics.control_limits
    for i, start in enumerate(starts):
        past = [start]
        for t in range(15):
            read = observation.readings(past[max(0, t - lag)]) + misread[i, t]
            mean = execute(np.concatenate([read, context[t, 1:]]))
            control = np.clip(mean + noise[i, t], low, high)
            assert_array_equal(controls[i, t], control)
            past.append(swimmer.dynamics.step(past[-1], control))
            assert_array_equal(states[i, t + 1], past[-1])
