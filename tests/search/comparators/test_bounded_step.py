# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The step of bounded divergence, beside a Riccati recursion and dense Gaussians of its own."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.marginals import Spread
from vgps_ros.core.records import CostExpansion, LinearDynamics
from vgps_ros.search.comparators.bounded_step import (
    LinearPolicy,
    bounded_step,
    divergence,
    propagate_marginals,
)

T, N_X, N_U = 8, 3, 2
LAXNESS = 1e-6  # by which a divergence may pass its bound [nat]


def positive(rng, n):
    root = rng.standard_normal((T, n, n))
    return root @ np.swapaxes(root, 1, 2) + 0.5 * np.eye(n)


@pytest.fixture
def problem(rng):
    """Some linear-quadratic problem, a policy and its spread."""
    linear = LinearDynamics(
        np.eye(N_X) + 0.3 * rng.standard_normal((T, N_X, N_X)), rng.standard_normal((T, N_X, N_U))
    )
    joint = positive(rng, N_X + N_U)
    cost = CostExpansion(
        np.zeros(T), rng.standard_normal((T, N_X)), rng.standard_normal((T, N_U)),
        joint[:, :N_X, :N_X], joint[:, N_X:, N_X:], joint[:, N_X:, :N_X],
    )  # fmt: skip
    policy = LinearPolicy(
        rng.standard_normal((T, N_U)), 0.3 * rng.standard_normal((T, N_U, N_X)), positive(rng, N_U)
    )
    spread = Spread(np.full(N_X, 0.4), np.full(N_X, 0.2), np.full(N_X, np.inf))
    return linear, cost, policy, rng.standard_normal(N_X), spread


def riccati(linear, cost, policy, eta, entropy):
    """Returns k, K and C of the least of E[c − η log p] − (w + η) H, by a recursion of its own."""
    p = np.linalg.inv(policy.covariances)
    m = np.concatenate([policy.gains, -np.tile(np.eye(N_U), (T, 1, 1))], axis=2)  # K δx − δu
    k, gains, c = (np.zeros_like(a) for a in vars(policy).values())
    v, vv = np.zeros(N_X), np.zeros((N_X, N_X))
    for t in reversed(range(T)):
        f = np.hstack([linear.f_x[t], linear.f_u[t]])
        h = np.block([[cost.c_xx[t], cost.c_ux[t].T], [cost.c_ux[t], cost.c_uu[t]]])
        g = np.concatenate([cost.c_x[t], cost.c_u[t]]) + eta * m[t].T @ p[t] @ policy.feedforward[t]
        h = (h + eta * m[t].T @ p[t] @ m[t]) / (entropy + eta) + f.T @ vv @ f
        g = g / (entropy + eta) + f.T @ v
        c[t] = np.linalg.inv(h[N_X:, N_X:])
        k[t], gains[t] = -c[t] @ g[N_X:], -c[t] @ h[N_X:, :N_X]
        v = g[:N_X] + h[:N_X, N_X:] @ k[t]
        vv = h[:N_X, :N_X] + h[:N_X, N_X:] @ gains[t]
    return k, gains, c


def expected_cost(cost, policy, means, sigma):
    total = 0.0
    for t in range(T):
        h = np.block([[cost.c_xx[t], cost.c_ux[t].T], [cost.c_ux[t], cost.c_uu[t]]])
        both = np.vstack([np.eye(N_X), policy.gains[t]])
        z = both @ means[t] + np.concatenate([np.zeros(N_X), policy.feedforward[t]])
        covariance = both @ sigma[t] @ both.T
        covariance[N_X:, N_X:] += policy.covariances[t]
        total += cost.c_x[t] @ z[:N_X] + cost.c_u[t] @ z[N_X:]
        total += 0.5 * (z @ h @ z + np.trace(h @ covariance))
    return total


@pytest.mark.parametrize("entropy", [0.0, 1.0])
@pytest.mark.parametrize("bound", [1e-3, 0.1, 1.0, 10.0])
def test_a_step_keeps_its_bound_and_is_that_of_the_riccati_recursion(problem, bound, entropy):
    step = bounded_step(*problem, bound, entropy)
    assert step.divergence <= bound + LAXNESS
    assert step.multiplier == 0.0 or step.divergence >= 0.98 * bound
    linear, cost, policy, *_ = problem
    expected = riccati(linear, cost, policy, step.multiplier, entropy)
    for found, value in zip(vars(step.policy).values(), expected, strict=True):
        assert_allclose(found, value, rtol=1e-6, atol=1e-8)


def test_a_step_without_a_binding_bound_is_the_unbounded_one(problem):
    step = bounded_step(*problem, 1e6, entropy=1.0)
    assert step.multiplier == 0.0


def test_no_other_policy_within_the_bound_costs_less(problem, rng):
    linear, cost, reference, start, spread = problem
    step = bounded_step(*problem, 0.5)
    least = expected_cost(cost, step.policy, step.means, step.state_covariances)
    found = 0
    for size in np.geomspace(1e-4, 0.3, 400):
        moved = dataclasses.replace(
            step.policy,
            feedforward=step.policy.feedforward + size * rng.standard_normal((T, N_U)),
            gains=step.policy.gains + size * rng.standard_normal((T, N_U, N_X)),
            covariances=step.policy.covariances * np.exp(size * rng.standard_normal()),
        )
        means, sigma = propagate_marginals(linear, moved, start, spread)
        kl = divergence(moved, reference, means, sigma)
        # The Lagrangian has its minimum at the step, and so has the cost within the bound.
        change = expected_cost(cost, moved, means, sigma) - least
        assert change + step.multiplier * (kl - step.divergence) >= -1e-9
        found += kl <= step.divergence
    assert found > 10


def test_the_divergence_is_that_of_the_dense_gaussians_of_whole_trajectories(problem, rng):
    linear, _, old, start, spread = problem
    new = bounded_step(*problem, 2.0).policy

    def joint(policy):
        """Returns mean and covariance of x_1, u_1, x_2 … x_{T+1}, by its linear map of noise."""
        n = N_X + T * (N_U + N_X)
        x, x_mean = np.zeros((N_X, n)), start
        x[:, :N_X] = np.diag(spread.initial_std)
        rows, means, at = [x], [x_mean], N_X
        for t in range(T):
            u = policy.gains[t] @ x
            u[:, at : at + N_U] = np.linalg.cholesky(policy.covariances[t])
            u_mean = policy.feedforward[t] + policy.gains[t] @ x_mean
            x = linear.f_x[t] @ x + linear.f_u[t] @ u
            x[:, at + N_U : at + N_U + N_X] = np.diag(spread.dynamics_std)
            x_mean = linear.f_x[t] @ x_mean + linear.f_u[t] @ u_mean
            rows, means, at = [*rows, u, x], [*means, u_mean, x_mean], at + N_U + N_X
        root = np.vstack(rows)
        return np.concatenate(means), root @ root.T

    (m, s), (m_0, s_0) = joint(new), joint(old)
    p = np.linalg.inv(s_0)
    expected = np.trace(p @ s) - len(m) + (m_0 - m) @ p @ (m_0 - m)
    expected = 0.5 * (expected + np.linalg.slogdet(s_0)[1] - np.linalg.slogdet(s)[1])
    assert_allclose(
        divergence(new, old, *propagate_marginals(linear, new, start, spread)), expected, rtol=1e-6
    )


def test_a_policy_is_that_of_its_energy(problem):
    policy = problem[2]
    again = LinearPolicy.of(policy.energy())
    for found, value in zip(vars(again).values(), vars(policy).values(), strict=True):
        assert_allclose(found, value, rtol=1e-9)


def test_a_step_says_when_even_its_start_explodes(problem):
    linear, cost, policy, start, spread = problem
    wild = LinearDynamics(1e3 * np.ones_like(linear.f_x), linear.f_u)
    with pytest.raises(DivergenceError, match="explode even under"):
        bounded_step(wild, cost, policy, start, spread, 1.0)
