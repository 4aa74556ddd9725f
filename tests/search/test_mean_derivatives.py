# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Solves whose q has the mean derivatives of samples: with limits, gaps, rotations and threads."""

import dataclasses

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.limited_pendulum import HIGH, write_task
from vgps_ros.core.checks import arrays_of
from vgps_ros.core.ddp.mean_derivatives import mean_derivatives
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.marginals import sample_joint_deviations
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.core.settings import with_values
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.tasks import make_task

TUMBLING = """
<mujoco>
  <option timestep="0.1" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body>
      <freejoint/>
      <geom type="box" size="0.1 0.2 0.3" density="100"/>
      <site name="jet" pos="0.1 0.2 0.3" euler="20 30 40"/>
    </body>
  </worldbody>
  <actuator><general site="jet" gear="1 0.5 0.2 0.3 0.4 0.5"/></actuator>
</mujoco>
"""


def sampled(task, count=4):
    values = {"dynamics_samples": count}
    return dataclasses.replace(task, optimizer=with_values(task.optimizer, values))


def test_a_linear_task_has_the_same_q(rng):
    rotor = make_task("rotor")
    request = first_request(rotor, 0, 5)
    plain, q = (optimize(task, request).distribution for task in (rotor, sampled(rotor)))
    for name, array in arrays_of(plain).items():
        scale = np.abs(array).max(initial=1e-9)
        assert_allclose(arrays_of(q)[name] / scale, array / scale, atol=1e-5, err_msg=name)


def test_of_a_body_that_turns_they_are_those_of_where_it_comes_by_the_deviation(finite_differences):
    """So by Stein's identity they are what a linear fit to samples of its motion tends to."""
    dynamics, rng = Dynamics(mujoco.MjModel.from_xml_string(TUMBLING)), np.random.default_rng(0)
    start = dynamics.space.add(np.eye(13)[3], rng.standard_normal(12))
    start[10:13] = 3.0, -2.0, 4.0
    nominal = dynamics.rollout(start, lambda *_: np.ones(1), 1)
    here = dynamics.linearize(nominal)[0]
    std = np.diag(np.repeat([0.1, 0.4, 0.3, 1.0], 3))
    sigma, gains = np.stack(2 * [std**2]), np.full((1, 1, 12), 0.3)
    q = TrajectoryDistribution(nominal, gains, np.ones((1, 1, 1)), here, sigma, np.empty((1, 0)))
    z = np.concatenate(sample_joint_deviations(q, 40, np.random.default_rng(1)), axis=2)[:, 0]

    def mean_motion(change):
        """Returns the mean of f(x ⊕ δ, u + δu) ⊖ f(x, u), where δ and δu are changed alike."""
        delta_x, delta_u = np.split(z + change, [12], axis=1)
        moved, controls = dynamics.space.add(start, delta_x), 1.0 + delta_u
        after = dynamics.rollouts(moved, lambda *_: controls, 1)[0][:, 1]
        return dynamics.space.subtract(after, nominal.states[1]).mean(axis=0)

    expected = finite_differences(mean_motion, np.zeros(13))
    linear, _ = mean_derivatives(dynamics, q, 40, 1.0, np.random.default_rng(1))
    found, plain = (np.hstack([f.f_x[0], f.f_u[0]]) for f in (linear, here))
    assert_allclose(found, expected, atol=5e-4)
    assert np.abs(plain - expected).max() > 5e-3


def test_the_motion_stays_and_its_q_follows_the_samples(short_swimmer, first_request):
    plain = optimize(short_swimmer, first_request)
    found, again = (optimize(sampled(short_swimmer), first_request) for _ in range(2))
    q, horizon = found.distribution, short_swimmer.planned_horizon
    assert_array_equal(q.mean.states, plain.distribution.mean.states)
    for name, array in arrays_of(q).items():
        assert_array_equal(array, arrays_of(again.distribution)[name])
    rng = generator(first_request.seed, Stream.DYNAMICS_DERIVATIVES, 0, 0)
    linear, steps = mean_derivatives(short_swimmer.dynamics, plain.distribution, 4, 0.3, rng)
    assert_array_equal(q.linear_dynamics.f_x, linear.f_x)
    assert np.abs(linear.f_x - plain.distribution.linear_dynamics.f_x).max() > 1e-5
    assert found.simulator_steps == plain.simulator_steps + steps
    assert steps >= 4 * horizon


def test_a_solve_that_goes_on_from_it_descends_along_the_trajectory(short_swimmer, next_request):
    """It must not take the means of the solve before for derivatives there."""
    request = dataclasses.replace(next_request, policy=None)
    expected = optimize(short_swimmer, request)
    previous = dataclasses.replace(
        request.previous,
        linear_dynamics=mean_derivatives(
            short_swimmer.dynamics,
            request.previous,
            4,
            0.3,
            generator(0, Stream.DYNAMICS_DERIVATIVES),
        )[0],
    )
    found = optimize(sampled(short_swimmer), dataclasses.replace(request, previous=previous))
    assert [i.cost for i in found.iterations] == [i.cost for i in expected.iterations]


@pytest.mark.parametrize("begin", ["", "begin: {law: path, file: up.csv}\n"])
def test_limits_clamp_and_gaps_close_as_without_samples(tmp_path, begin):
    (tmp_path / "up.csv").write_text("time,hinge/position\n0,0\n1,3\n")
    task = sampled(make_task(write_task(tmp_path, ("search:", begin + "search:"))))
    q = optimize(task, first_request(task, 0, 50)).distribution
    clamped = (q.mean.controls == HIGH)[:, 0]
    assert 5 < clamped.sum() < len(clamped)
    assert not q.gains[clamped].any()
    assert not q.control_covariances[clamped].any()
    replayed = task.dynamics.rollout(
        task.initial_state, lambda t, _: q.mean.controls[t], task.horizon
    )
    assert_array_equal(replayed.states, q.mean.states)


def test_number_of_threads_does_not_change_a_bit(short_swimmer, first_request):
    q, model = optimize(short_swimmer, first_request).distribution, short_swimmer.dynamics.model
    one, *others = (
        mean_derivatives(
            Dynamics(model, threads=n), q, 4, 1.0, generator(0, Stream.DYNAMICS_DERIVATIVES)
        )
        for n in (1, 2, 5)
    )
    for linear, steps in others:
        assert steps == one[1]
        assert_array_equal(linear.f_x, one[0].f_x)
        assert_array_equal(linear.f_u, one[0].f_u)


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("dynamics_samples", -1, "dynamics_samples is -1, but it must be from 0 to 1000"),
        ("dynamics_samples", 2.0, "dynamics_samples is 2.0, but it must be a whole number"),
        ("dynamic_samples", 4, "dynamics_samples"),
    ],
)
def test_bad_settings_are_refused(name, value, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        with_values(OptimizerSettings(), {name: value})
