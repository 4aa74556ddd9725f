# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The terms of the variational bound, where they are known in closed form."""

import numpy as np
from numpy.testing import assert_allclose

from vgps_ros.core.bound import balanced_deviations, expected_cost, expected_divergence
from vgps_ros.core.records import CostExpansion


class Quadratic:
    """c(z) = ½ zᵀ H z with z = (x, u), at each step the same."""

    def __init__(self, hessian, n_x):
        self.hessian, self.n_x = hessian, n_x

    def expand(self, trajectory):
        n, h = self.n_x, self.hessian
        z = np.hstack([trajectory.states[:-1], trajectory.controls])
        tiled = np.tile(h, (len(z), 1, 1))
        blocks = tiled[:, :n, :n], tiled[:, n:, n:], tiled[:, n:, :n]
        return CostExpansion(
            0.5 * np.sum(z @ h * z, axis=1), (z @ h)[:, :n], (z @ h)[:, n:], *blocks
        )


def test_the_expected_quadratic_cost_is_that_of_the_joint_gaussian(
    random_distribution, random_covariances
):
    q, (hessian,) = random_distribution(), random_covariances(1, 6)
    expected = 0.0
    for t in range(q.mean.horizon):
        z = np.concatenate([q.mean.states[t], q.mean.controls[t]])
        both = np.vstack([np.eye(4), q.gains[t]])
        covariance = both @ q.state_covariances[t] @ both.T
        covariance[4:, 4:] += q.control_covariances[t]
        expected += 0.5 * (z @ hessian @ z + np.trace(hessian @ covariance))
    assert_allclose(expected_cost(q, Quadratic(hessian, 4)), expected, rtol=1e-12)


def test_the_divergence_of_a_linear_policy_is_averaged_exactly(
    random_distribution, random_policy, coordinates, rng
):
    q, policy = random_distribution(), random_policy(hidden_units=())
    bias = policy.mean(np.zeros(3))
    weights = np.zeros((2, 4))
    weights[:, [0, 2, 3]] = (policy.mean(np.eye(3)) - bias).T
    variances, expected = policy.noise_std**2, 0.0
    for t in range(q.mean.horizon):
        noise = q.control_covariances[t]
        away = q.mean.controls[t] - weights @ q.mean.states[t] - bias
        turned = q.gains[t] - weights
        squares = away**2 + np.diag(turned @ q.state_covariances[t] @ turned.T) + np.diag(noise)
        expected += 0.5 * np.sum(squares / variances - 1.0)
        expected += 0.5 * (np.log(variances).sum() - np.linalg.slogdet(noise)[1])
    found = expected_divergence(q, policy, coordinates(0, 2, 3), rng)
    assert_allclose(found, expected, rtol=1e-10)


def test_balanced_deviations_have_exactly_the_marginals_moments(random_distribution, rng):
    q = random_distribution()
    deviations = balanced_deviations(q, rng)
    assert deviations.shape == (8, 6, 4)
    assert_allclose(deviations.mean(axis=0), 0.0, atol=1e-15)
    found = np.einsum("stx,sty->txy", deviations, deviations) / 8
    assert_allclose(found, q.state_covariances[:-1], rtol=1e-10, atol=1e-12)
