# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The variational bound, on the rotor, whose dynamics are linear and whose cost is quadratic."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vgps_ros.core.bound import expected_cost, expected_divergence
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.methods import search
from vgps_ros.search.metrics import unlimited_marginals
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.trajectory_optimization import optimize, optimize_all
from vgps_ros.tasks import make_task

FIXED = SearchSettings(iterations=10, alphas=(1.0,), evaluation_rollouts=1)


@pytest.fixture
def rotor():
    return make_task("rotor")


@pytest.fixture
def linear_policy(rotor):
    shape = Architecture(rotor.observation.names, (), 1)
    return GaussianPolicy(shape, [-1.0, -0.8, 0.3], [0.7])


def bound(task, q, policy, alpha, rng):
    """Returns L(q, θ) of section 3."""
    divergence = expected_divergence(q, policy, task.observation, rng)
    return -alpha * expected_cost(q, task.cost) - divergence


def log_likelihood(task, policy, alpha):
    """Returns log E[exp(−α Σ c)] over the policy's noise from x_1, as one Gaussian integral."""
    steps, sigma = task.horizon, policy.noise_std[0]
    noise = np.concatenate([np.zeros((1, steps)), np.eye(steps)])[..., None]
    starts = np.tile(task.initial_state, (steps + 1, 1))
    states, controls = task.dynamics.execute(policy, task.observation, starts, noise)
    rows = np.concatenate([states[:, :-1], controls], axis=2) * np.sqrt([1.0, 0.1, 1.0])
    rows = rows.reshape(steps + 1, -1)  # its squares sum to the cost
    mean, change = rows[0], rows[1:] - rows[0]
    hessian = np.eye(steps) / sigma**2 + 2 * alpha * change @ change.T
    slope = 2 * alpha * change @ mean
    exponent = 0.5 * slope @ np.linalg.solve(hessian, slope) - alpha * mean @ mean
    return exponent - 0.5 * np.linalg.slogdet(sigma**2 * hessian)[1]


@pytest.mark.parametrize("limit", [np.inf, 0.03])
@pytest.mark.parametrize("alpha", [0.2, 0.5, 1.0, 5.0, 20.0])
def test_the_bound_is_the_log_likelihood_for_the_best_q_and_below_it_for_others(
    rotor, linear_policy, rng, alpha, limit
):
    """Section 3: log p(O|θ) − L(q, θ) is a divergence, which the q-step brings to zero."""
    marginals = replace(rotor.optimizer.marginals, initial_std_factor=0.0)
    optimizer = replace(rotor.optimizer, marginals=marginals)
    task = replace(rotor, optimizer=optimizer, std_limit=np.full(2, limit))
    first = replace(first_request(task, 0, 20), guess=np.zeros((50, 1)))
    others = optimize(task, first).distribution
    request = replace(first, cost_scale=alpha, guess=None, previous=others, policy=linear_policy)
    best = optimize(task, request).distribution
    expected = log_likelihood(task, linear_policy, alpha)
    found = bound(task, unlimited_marginals(task, best), linear_policy, alpha, rng)
    assert_allclose(found, expected, rtol=1e-6)
    assert (
        bound(task, unlimited_marginals(task, others), linear_policy, alpha, rng) < expected - 1.0
    )
    cut = bound(task, best, linear_policy, alpha, rng)
    assert (cut > expected + 0.01) == (limit < 1.0)  # which is why it is not the one that is told


def test_the_expected_cost_is_the_mean_over_draws(rotor, rng):
    q = optimize(rotor, replace(first_request(rotor, 0, 20), guess=np.zeros((50, 1)))).distribution
    draws = np.linalg.cholesky(q.state_covariances[:-1] + 1e-12 * np.eye(2))
    deviations = np.einsum("txy,sty->stx", draws, rng.standard_normal((20_000, 50, 2)))
    controls = q.mean.controls + np.einsum("tux,stx->stu", q.gains, deviations)
    controls += np.sqrt(q.control_covariances[:, 0]) * rng.standard_normal(controls.shape)
    costs = rotor.cost(q.mean.states[:-1] + deviations, controls).sum(axis=1)
    error = costs.std() / np.sqrt(len(costs))
    assert expected_cost(q, rotor.cost) == pytest.approx(costs.mean(), abs=5 * error)


def test_at_a_fixed_alpha_no_step_lowers_the_bound(rotor):
    iterations = list(search("vgps", rotor, FIXED, 0, partial(optimize_all, rotor)))
    assert min(i.m_step_gain for i in iterations) > 0.0
    assert min(i.q_step_gain for i in iterations) > 0.0
    bounds = np.array([i.bound for i in iterations])
    gains = [i.m_step_gain + i.q_step_gain for i in iterations[1:]]
    assert_allclose(np.diff(bounds), gains, rtol=1e-9)
    assert not any("bound" in warning for i in iterations for warning in i.warnings)


def test_the_bound_that_is_told_is_that_of_q_uncut(rotor):
    task = replace(rotor, std_limit=np.full(2, 0.03))
    settings = replace(FIXED, iterations=1)
    (told,) = search("vgps", task, settings, 0, partial(optimize_all, task))
    q = told.solutions[0].distribution
    found = [
        bound(task, each, told.policy, 1.0, generator(0, Stream.BOUND, 0))
        for each in (unlimited_marginals(task, q), q)
    ]
    assert told.bound == found[0]
    assert abs(found[1] - found[0]) > 0.1


def test_marginals_that_explode_uncut_give_no_bound(rotor, monkeypatch):
    monkeypatch.setattr("vgps_ros.core.marginals.STD_BOUND", 0.04)
    task, settings = replace(rotor, std_limit=np.full(2, 0.03)), replace(FIXED, iterations=1)
    (told,) = search("vgps", task, settings, 0, partial(optimize_all, task))
    assert told.bound == -np.inf
    assert told.history[-1].entry()["bound"] is None
    assert told.m_step_gain > 0.0


def test_an_iteration_that_lowers_the_bound_says_so(rotor):
    """From the fourth on, q is the one of the second: the policy has moved on since."""
    kept = []

    def solve(requests):
        k = requests[0].iteration
        kept.append(optimize_all(rotor, requests))
        return kept[2] if k > 3 else kept[-1]

    iterations = list(search("vgps", rotor, FIXED, 0, solve))
    said = [i.k for i in iterations if any("lowered the bound" in w for w in i.warnings)]
    assert said == [4]
    assert "The q-step of iteration 4 lowered the bound L(q, theta) by" in iterations[3].warnings[0]
    assert_allclose([i.q_step_gain for i in iterations[4:]], 0.0, atol=1e-9)
