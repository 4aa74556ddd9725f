# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Policies of a robot whose limits the optimised motion reaches."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.limited_pendulum import HIGH, LOW, write_task
from tests.search.test_bound import bound
from vgps_ros.core.marginals import sample_rollout_noise
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.core.settings import with_values
from vgps_ros.search.methods import METHODS, search
from vgps_ros.search.metrics import unlimited_marginals
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.situations import Situation
from vgps_ros.search.trajectory_optimization import optimize, optimize_all
from vgps_ros.search.workspace import Workspace
from vgps_ros.tasks import make_task
from vgps_ros.tasks.environment import TaskEnvironment


@pytest.fixture
def path(tmp_path):
    return write_task(tmp_path)


@pytest.fixture
def task(path):
    return make_task(path)


@pytest.fixture
def q(task):
    guess = np.zeros((task.horizon, 1))
    request = OptimizationRequest(0, 0, 0, 1.0, 50, Situation.at_start(task), guess)
    return optimize(task, request).distribution


def constant_policy(task, control):
    shape = Architecture(task.observation.names, (), 1)
    return GaussianPolicy(shape, [0.0] * (shape.num_parameters - 1) + [control], [1e-3])


def test_the_optimised_motion_pulls_at_its_limit_and_never_beyond(task, q):
    assert q.mean.controls.max() == HIGH
    assert q.mean.controls.min() >= LOW
    replayed = task.dynamics.rollout(q.mean.states[0], lambda t, _: q.mean.controls[t], 50)
    assert_array_equal(replayed.states, q.mean.states)


def test_a_clamped_control_has_no_noise_and_its_step_can_be_drawn(q, rng):
    clamped = (q.mean.controls == HIGH)[:, 0]
    assert 5 < clamped.sum() < len(clamped)
    assert not q.control_covariances[clamped].any()
    assert not q.gains[clamped].any()
    noise = sample_rollout_noise(q, 200, rng)
    assert not noise[:, clamped].any()
    assert (noise[:, q.control_covariances[:, 0, 0] > 0].std(axis=0) > 0).all()


def test_derivatives_at_a_limit_are_those_of_the_inside(task, q):
    at_limit = dataclasses.replace(q.mean, controls=np.full_like(q.mean.controls, HIGH))
    inside = dataclasses.replace(q.mean, controls=np.full_like(q.mean.controls, HIGH - 1e-3))
    for centred in (False, True):
        found, expected = (
            task.dynamics.linearize(m, centred=centred)[0] for m in (at_limit, inside)
        )
        assert_allclose(found.f_u, expected.f_u, rtol=1e-4)


def test_controls_at_a_limit_are_taught_beyond_it_and_others_as_they_are(task):
    def taught(**values):
        settings = with_values(SearchSettings(), {"initial_ddp_iterations": 50, **values})
        work = Workspace(task, settings, 0, partial(optimize_all, task))
        (q,) = work.taught(work.initial_solutions)
        return q.mean.controls

    usual, beyond = taught(), taught(**{"fit.beyond": 0.2})
    at_limit = usual == HIGH
    assert at_limit.any()
    assert_allclose(beyond[at_limit], HIGH + 0.1 * (HIGH - LOW))
    within = (usual < HIGH) & (usual > LOW)
    assert_array_equal(beyond[within], usual[within])


def test_the_bound_is_that_of_q_and_not_of_what_is_taught_beyond_the_limits(task):
    values = {"iterations": 1, "initial_ddp_iterations": 50, "alphas": (1.0,), "fit.beyond": 0.2}
    settings = with_values(SearchSettings(), values)
    (told,) = search("vgps", task, settings, 0, partial(optimize_all, task))
    q = told.solutions[0].distribution.first(task.horizon)
    assert (q.mean.controls == HIGH).any()
    rng = generator(0, Stream.BOUND, 0)
    assert told.bound == pytest.approx(
        bound(task, unlimited_marginals(task, q), told.policy, 1.0, rng)
    )


@pytest.mark.parametrize("method", sorted(set(METHODS) - {"cost_weighted_1000"}))
def test_every_method_trains_a_policy_within_the_limits(task, method):
    settings = with_values(SearchSettings(), task.search)
    ddp = None
    for metrics in search(method, task, settings, 0, partial(optimize_all, task)):
        ddp = metrics.initial_ddp_cost
        assert np.isfinite(metrics.policy_kl)
    assert metrics.k == 3
    assert metrics.deterministic_cost < 1.5 * ddp


def test_rollouts_and_environment_apply_and_score_the_clipped_control(task, path):
    policy, start = constant_policy(task, 7.0), task.initial_state[None]
    noise = np.zeros((1, task.horizon, 1))
    states, controls = task.dynamics.execute(policy, task.observation, start, noise)
    same, recorded, _ = task.dynamics.rollouts(start, lambda t, x: np.full((1, 1), 7.0), 50)
    assert (controls == HIGH).all()
    assert_array_equal(recorded, controls)
    assert_array_equal(same, states)
    environment = TaskEnvironment(path, torque_scale=7.0)
    environment.reset(options={"exact": True})
    for t in range(task.horizon):
        *_, told = environment.step(np.ones(1))
        assert told["cost"] == task.cost(states[:, [t]], controls[:, [t]], t)[0, 0]
        assert_array_equal(environment.state, states[0, t + 1])


def test_a_control_without_a_number_is_not_hidden_by_the_limits(task):
    start = task.initial_state[None]
    states, controls, _ = task.dynamics.rollouts(start, lambda t, x: np.full((1, 1), np.nan), 3)
    assert np.isnan(controls).all()
    assert np.isnan(states[:, 1:]).all()


def test_a_motor_that_cannot_move_is_trained_all_the_same(tmp_path):
    path = write_task(tmp_path)
    model = tmp_path / "pendulum.xml"
    model.write_text(model.read_text().replace("-0.5 1.5", "-1e-12 1e-12"))
    task = make_task(path)
    settings = with_values(SearchSettings(), task.search)
    for metrics in search("vgps", task, settings, 0, partial(optimize_all, task)):
        assert np.isfinite(metrics.deterministic_cost)
        assert metrics.deterministic_cost < 1.01 * metrics.ddp_cost


def test_first_noise_is_drawn_within_the_limits(tmp_path):
    path = write_task(tmp_path, ("search:", "begin: {law: noise, std: 10.0}\nsearch:"))
    task = make_task(path)
    controls = task.begin.controls(task, 50, generator(0, Stream.INITIAL_CONTROLS, 0))
    assert controls.min() == LOW
    assert controls.max() <= HIGH
