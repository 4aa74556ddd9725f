# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The quadratic problem with bounds, against its optimality conditions and other solvers."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear

from vgps_ros.core.ddp.backward_pass import backward_pass, minimize_in_box
from vgps_ros.core.ddp.solve import Status, solve
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.optimizer_settings import DdpSettings


def minimum_in_box(hessian, gradient, low, high, start):
    k, free = start.copy(), np.zeros(len(start), bool)
    minimize_in_box(hessian, gradient, low, high, k, free)
    return k, free


def random_problem(rng):
    n = int(rng.integers(1, 9))
    root = rng.standard_normal((n, n))
    hessian = root @ root.T + 10.0 ** rng.uniform(-3, 1) * np.eye(n)
    low, high = np.sort(rng.standard_normal((2, n)), axis=0)
    low[rng.random(n) < 0.2] = -np.inf
    high[rng.random(n) < 0.2] = np.inf
    still = rng.random(n) < 0.1
    high = np.where(still & np.isfinite(low), low, high)
    return hessian, 3.0 * rng.standard_normal(n), low, high


@pytest.mark.parametrize("seed", range(200))
def test_minimum_fulfils_its_optimality_conditions_and_is_that_of_another_solver(seed):
    rng = np.random.default_rng(seed)
    hessian, gradient, low, high = random_problem(rng)
    k, free = minimum_in_box(hessian, gradient, low, high, rng.standard_normal(len(gradient)))
    slope = gradient + hessian @ k
    assert (low <= k).all()
    assert (k <= high).all()
    assert_allclose(slope[free], 0.0, atol=1e-9)
    assert (slope[(k < high) & (low < k)] <= 1e-9).all()
    assert (slope[(k > low) & (k == high) & ~free] <= 0.0).all()
    assert (slope[(k < high) & (k == low) & ~free] >= 0.0).all()
    moves = low < high
    root = np.linalg.cholesky(hessian).T
    held = np.where(moves, 0.0, k)
    target = -np.linalg.solve(root.T, gradient) - root @ held
    other = lsq_linear(root[:, moves], target, (low[moves], high[moves]), "bvls", tol=1e-14)
    assert_allclose(k[moves], other.x, rtol=1e-7, atol=1e-7)


def test_another_start_finds_the_same_minimum(rng):
    hessian, gradient, low, high = random_problem(rng)
    found = [
        minimum_in_box(hessian, gradient, low, high, 10 * rng.standard_normal(len(gradient)))[0]
        for _ in range(10)
    ]
    assert_allclose(found, np.broadcast_to(found[0], np.shape(found)), atol=1e-10)


def dense_boxed(problem, start, limit):
    """Solves the whole problem in its controls, whose bounds are all that is left, by scipy."""
    horizon, n_x, n_u = problem.linear.f_u.shape
    states = np.zeros((horizon + 1, n_x, horizon * n_u))
    offsets = np.zeros((horizon + 1, n_x))
    offsets[0] = start
    for t in range(horizon):
        a, b = problem.linear.f_x[t], problem.linear.f_u[t]
        states[t + 1] = a @ states[t]
        states[t + 1][:, t * n_u : (t + 1) * n_u] += b
        offsets[t + 1] = a @ offsets[t]
    select = np.eye(horizon * n_u).reshape(horizon, n_u, horizon * n_u)
    matrix = np.concatenate([states[:-1], select], axis=1).reshape(-1, horizon * n_u)
    offset = np.pad(offsets[:-1], ((0, 0), (0, n_u))).ravel()
    whole = block_diag(*problem.hessians)
    hessian = matrix.T @ whole @ matrix
    gradient = matrix.T @ (problem.gradients.ravel() + whole @ offset)
    root = np.linalg.cholesky(hessian).T
    target = -np.linalg.solve(root.T, gradient)
    found = lsq_linear(root, target, (-limit, limit), "bvls", tol=1e-14, max_iter=1000)
    return found.x.reshape(horizon, n_u)


@pytest.mark.parametrize("limit", [0.05, 0.3, 1.0])
def test_solve_within_limits_is_the_dense_problem_with_bounds(lq_problem, rng, limit):
    problem = dataclasses.replace(lq_problem(), limit=limit)
    start = rng.standard_normal(problem.state_dim)
    initial = problem.rollout(start, lambda t, x: np.zeros(2), problem.horizon)
    solution = solve(problem, problem, initial, DdpSettings(), 200, cost_tolerance=0.0)
    expected = dense_boxed(problem, start, limit)
    clamped = np.abs(expected) > limit - 1e-9  # the other solver may stop within rounding of it
    assert clamped.any()
    assert_allclose(solution.trajectory.controls, expected, atol=1e-6)
    assert (np.abs(solution.trajectory.controls[clamped]) == limit).all()
    assert_array_equal(solution.policy.free, ~clamped)


def test_clamped_controls_have_neither_gains_nor_noise(lq_problem):
    problem = dataclasses.replace(lq_problem(n_u=3), limit=0.3)
    policy = solve(problem, problem, problem.at_rest(), DdpSettings(), 50).policy
    covariances = policy.control_covariances()
    assert 0 < policy.free.sum() < policy.free.size
    for t, free in enumerate(policy.free):
        assert not policy.gains[t][~free].any()
        assert not covariances[t][~free].any()
        assert not covariances[t][:, ~free].any()
        inverse = np.linalg.inv(policy.q_uu[t][free][:, free])
        assert_allclose(covariances[t][free][:, free], inverse, rtol=1e-9)


def test_limits_that_nothing_reaches_change_no_bit(lq_problem):
    problem = lq_problem()
    expansion = problem.expand(problem.at_rest())
    shape = problem.linear.f_u.shape[::2]
    bounds = (np.full(shape, -1e3), np.full(shape, 1e3))
    free, boxed = (backward_pass(problem.linear, expansion, 0.1, b) for b in (None, bounds))
    for name, value in vars(free).items():
        assert_array_equal(value, getattr(boxed, name))


def test_limits_that_exclude_the_first_controls_are_kept_from_the_first_step_on(lq_problem):
    problem = dataclasses.replace(lq_problem(), limit=0.2)
    far = dataclasses.replace(problem, limit=5.0)
    initial = far.rollout(np.ones(4), lambda t, x: np.full(2, 5.0), problem.horizon)
    solution = solve(problem, problem, initial, DdpSettings(), 50)
    assert np.abs(solution.trajectory.controls).max() <= 0.2


def test_a_control_that_cannot_move_stays(lq_problem):
    problem = dataclasses.replace(lq_problem(), limit=0.0)
    solution = solve(problem, problem, problem.at_rest(), DdpSettings(), 5)
    assert solution.status is Status.CONVERGED
    assert_array_equal(solution.trajectory.controls, 0.0)
    assert not solution.policy.control_covariances().any()


def test_contradictory_limits_are_an_error_that_names_them(lq_problem):
    problem = dataclasses.replace(lq_problem(), limit=-1.0)
    with pytest.raises(InvalidInputError, match=r"Control 0 has limits from 1 to -1.*correct"):
        solve(problem, problem, problem.at_rest(), DdpSettings(), 5)
