# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import dataclasses
import textwrap
from importlib import import_module
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vgps_ros.core.checks import check_covariances
from vgps_ros.core.ddp.backward_pass import backward_pass


def follow(problem, policy, start, step_size=1.0):
    return problem.rollout(
        start,
        lambda t, x: step_size * policy.feedforward[t] + x @ policy.gains[t].T,
        problem.horizon,
    )


def minimum(hessian, gradient, low, high):
    """Minimises ½ kᵀ H k + gᵀ k within bounds by trying every set of clamped coordinates."""
    best, lowest = None, np.inf
    for sides in map(np.array, product((-1, 0, 1), repeat=len(gradient))):
        k, f = np.where(sides < 0, low, np.where(sides > 0, high, 0.0)), sides == 0
        if not np.isfinite(k).all():
            continue
        k[f] = -np.linalg.solve(hessian[f][:, f], gradient[f] + hessian[f][:, ~f] @ k[~f])
        value = 0.5 * k @ hessian @ k + gradient @ k
        if value < lowest and (low <= k).all() and (k <= high).all():
            best, lowest = k, value
    return best


def bounds_of(problem, low=-np.inf, high=np.inf):
    shape = problem.linear.f_u.shape[::2]
    return np.broadcast_to(low, shape).copy(), np.broadcast_to(high, shape).copy()


def readable_backward_pass(linear, cost, mu, bounds, gaps, slopes):
    """Executes the form that the module's docstring shows; returns its variables."""
    docstring = import_module("vgps_ros.core.ddp.backward_pass").__doc__
    code = textwrap.dedent(docstring.partition("reads:\n\n")[2])
    (horizon, n_x, n_u) = linear.f_u.shape
    variables = vars(linear) | vars(cost)
    variables |= {"np": np, "horizon": horizon, "n_x": n_x, "n_u": n_u, "mu": mu}
    variables |= {"minimum": minimum, "low": bounds[0], "high": bounds[1], "gaps": gaps}
    variables["slopes"] = slopes
    exec(code, variables)
    return variables


@pytest.mark.parametrize("start_scale", [0.0, 1.0])
def test_following_the_policy_solves_the_dense_kkt_system(lq_problem, rng, start_scale):
    problem = lq_problem(horizon=15)
    policy = backward_pass(problem.linear, problem.expand(problem.at_rest()))
    start = start_scale * rng.standard_normal(problem.state_dim)
    trajectory = follow(problem, policy, start)
    states, controls = problem.optimum(start)
    assert policy.complete
    assert_allclose(trajectory.controls, controls, rtol=0, atol=1e-9)
    assert_allclose(trajectory.states[:-1], states, rtol=0, atol=1e-9)


@pytest.mark.parametrize("mu", [0.0, 0.1, 10.0])
@pytest.mark.parametrize("size", [{}, {"n_x": 7, "n_u": 1}, {"n_x": 3, "n_u": 3, "horizon": 1}])
@pytest.mark.parametrize("limit", [np.inf, 0.1])
def test_compiled_pass_is_the_readable_one_of_the_docstring(lq_problem, rng, mu, size, limit):
    problem = lq_problem(**size)
    expansion = problem.expand(problem.at_rest())
    bounds = bounds_of(problem, -limit, 2 * limit)
    gaps = (limit < np.inf) * rng.standard_normal(problem.linear.f_x.shape[:2])
    slopes = (limit < np.inf) * rng.standard_normal((2, *expansion.c_ux.shape))
    policy = backward_pass(problem.linear, expansion, mu, bounds, gaps, slopes)
    assert policy.free.all() or limit < np.inf
    found = readable_backward_pass(problem.linear, expansion, mu, bounds, gaps, slopes)
    for name, value in vars(policy).items():
        if name != "complete":
            expected = found["k" if name == "feedforward" else name]
            assert_allclose(value, expected, rtol=1e-10, atol=1e-10, err_msg=name)


def test_regularisation_shortens_the_deviation_of_the_next_state(lq_problem):
    problem = lq_problem()
    expansion = problem.expand(problem.at_rest())

    def deviation(mu):
        k = backward_pass(problem.linear, expansion, mu).feedforward
        return np.linalg.norm(np.einsum("txu,tu->tx", problem.linear.f_u, k))

    assert deviation(0.0) > deviation(1.0) > deviation(100.0)


@pytest.mark.parametrize("step_size", [1.0, 0.5, 0.1, 0.01])
def test_expected_reduction_is_that_of_the_quadratic_model(lq_problem, step_size):
    problem = lq_problem()
    policy = backward_pass(problem.linear, problem.expand(problem.at_rest()))
    moved = follow(problem, policy, np.zeros(problem.state_dim), step_size)
    assert_allclose(policy.expected_reduction(step_size), -problem.values(moved).sum(), rtol=1e-10)


def test_expected_reduction_of_a_full_regularised_step_is_that_of_the_model(lq_problem):
    problem = lq_problem()
    policy = backward_pass(problem.linear, problem.expand(problem.at_rest()), 1.0)
    moved = follow(problem, policy, np.zeros(problem.state_dim))
    assert_allclose(policy.expected_reduction(1.0), -problem.values(moved).sum(), rtol=1e-10)


def test_control_covariance_is_the_inverse_of_quu(lq_problem):
    problem = lq_problem(n_u=3)
    policy = backward_pass(problem.linear, problem.expand(problem.at_rest()))
    product = policy.control_covariances() @ policy.q_uu
    assert_allclose(product, np.tile(np.eye(3), (problem.horizon, 1, 1)), atol=1e-10)


def test_the_inverse_of_a_nearly_singular_quu_is_a_covariance(lq_problem, rng):
    problem = lq_problem(n_u=3)
    policy = backward_pass(problem.linear, problem.expand(problem.at_rest()))
    axes = np.linalg.qr(rng.standard_normal(policy.q_uu.shape))[0]
    q_uu = axes * [1e-9, 3e-9, 1e6] @ axes.swapaxes(1, 2)
    q_uu = (q_uu + q_uu.swapaxes(1, 2)) / 2
    check_covariances("q", dataclasses.replace(policy, q_uu=q_uu).control_covariances())


@pytest.mark.parametrize("bad", [-1e3, np.nan])
def test_quu_that_is_not_positive_definite_is_reported(lq_problem, bad):
    problem = lq_problem()
    expansion = problem.expand(problem.at_rest())
    c_uu = expansion.c_uu.copy()
    c_uu[4, 1, 1] = bad
    expansion = dataclasses.replace(expansion, c_uu=c_uu)
    assert not backward_pass(problem.linear, expansion).complete


def test_regularisation_makes_an_indefinite_quu_solvable(lq_problem):
    problem = lq_problem()
    expansion = problem.expand(problem.at_rest())
    expansion = dataclasses.replace(expansion, c_uu=expansion.c_uu - 5.0 * np.eye(2))
    assert not backward_pass(problem.linear, expansion).complete
    assert backward_pass(problem.linear, expansion, 1e4).complete
