# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.records import Trajectory

ALPHA, HORIZON, N_X, N_U, SAMPLES = 0.7, 4, 4, 2, 3


@pytest.fixture
def trajectory(rng):
    return Trajectory(rng.standard_normal((HORIZON + 1, N_X)), rng.standard_normal((HORIZON, N_U)))


@dataclass(frozen=True)
class Linear:
    """The features A x."""

    matrix: np.ndarray

    def __call__(self, states, controls):
        return states @ self.matrix.T

    def linearize(self, states, controls):
        by_state = np.broadcast_to(self.matrix, (*states.shape[:-1], 2, N_X))
        return self(states, controls), by_state, np.zeros((*states.shape[:-1], 2, N_U))


@pytest.fixture
def scaled(rng):
    features = Linear(rng.standard_normal((2, N_X)))
    targets, control_weights = np.array([0.5, -0.5]), np.full(N_U, 0.2)
    cost = FeatureCost(features, targets, np.ones(2), np.zeros(2), control_weights)
    return ScaledCost(cost, ALPHA)


@pytest.fixture
def make_cost(rng, scaled, coordinates, random_policy):
    def make(**shape):
        deviations = rng.standard_normal((SAMPLES, HORIZON, N_X))
        gains = rng.standard_normal((HORIZON, N_U, N_X))
        return PolicyCost(scaled, random_policy(**shape), coordinates(0, 2, 3), deviations, gains)

    return make


def policy_mean(cost, states):
    return cost.policy.mean(cost.observation(states))


def hessians(expansion, start=None):
    """[c_xx c_xu; c_ux c_uu] of each step, less that of `start`."""
    blocks = [expansion.c_xx, np.swapaxes(expansion.c_ux, 1, 2), expansion.c_ux, expansion.c_uu]
    joined = np.block([[blocks[0], blocks[1]], [blocks[2], blocks[3]]])
    return joined if start is None else joined - hessians(start)


def test_scaled_cost_is_alpha_times_everything(scaled, trajectory):
    plain, expansion = scaled.cost.expand(trajectory), scaled.expand(trajectory)
    assert_array_equal(scaled.values(trajectory), ALPHA * scaled.cost.values(trajectory))
    for name, values in vars(expansion).items():
        assert_array_equal(values, ALPHA * getattr(plain, name))


def test_values_average_the_log_density_of_jointly_shifted_samples(make_cost, trajectory):
    cost = make_cost()
    covariance = np.diag(cost.policy.noise_std**2)
    for t, value in enumerate(cost.values(trajectory)):
        log_densities = [
            multivariate_normal.logpdf(
                trajectory.controls[t] + cost.gains[t] @ delta,
                policy_mean(cost, trajectory.states[t] + delta),
                covariance,
            )
            for delta in cost.deviations[:, t]
        ]
        expected = cost.scaled.values(trajectory)[t] - np.mean(log_densities)
        assert_allclose(value, expected, rtol=1e-12)
    assert_array_equal(cost.expand(trajectory).c, cost.values(trajectory))


@pytest.mark.parametrize("activation", ["softplus", "tanh"])
def test_gradients_are_those_of_the_averaged_values(
    make_cost, trajectory, finite_differences, activation
):
    """The deviations stay as they are, so the line search judges what was differentiated."""
    cost = make_cost(activation=activation)
    states, controls = trajectory.states, trajectory.controls
    by_states = finite_differences(lambda x: cost.values(Trajectory(x, controls)).sum(), states)
    by_controls = finite_differences(lambda u: cost.values(Trajectory(states, u)).sum(), controls)
    expansion = cost.expand(trajectory)
    assert_allclose(expansion.c_x, by_states[:-1], atol=1e-7)
    assert_allclose(expansion.c_u, by_controls, atol=1e-7)
    assert_array_equal(by_states[-1], 0.0)


def test_hessian_is_the_mean_gauss_newton_matrix(make_cost, trajectory, finite_differences):
    cost = make_cost()
    precision = np.diag(1 / cost.policy.noise_std**2)
    found = hessians(cost.expand(trajectory), cost.scaled.expand(trajectory))
    for t in range(HORIZON):
        expected = 0.0
        for delta in cost.deviations[:, t]:
            j = finite_differences(partial(policy_mean, cost), trajectory.states[t] + delta)
            residual_by_z = np.hstack([-j, np.eye(N_U)])  # r = u − μ(x)
            expected += residual_by_z.T @ precision @ residual_by_z / SAMPLES
        assert_allclose(found[t], expected, atol=1e-8)
        assert np.linalg.eigvalsh(found[t])[0] > -1e-12


def test_hessian_of_a_linear_policy_is_exact(make_cost, trajectory, finite_differences):
    cost = make_cost(hidden_units=())
    z = np.hstack([trajectory.states[:-1], trajectory.controls])

    def gradient(z):
        states = np.vstack([z[:, :N_X], trajectory.states[-1:]])
        e = cost.expand(Trajectory(states, z[:, N_X:]))
        return np.hstack([e.c_x, e.c_u])

    found, exact = hessians(cost.expand(trajectory)), finite_differences(gradient, z)
    for t in range(HORIZON):
        assert_allclose(found[t], exact[t, :, t], atol=1e-7)


def test_single_zero_deviation_is_the_point_cost(make_cost, trajectory):
    cost = make_cost()
    point = replace(cost, deviations=np.zeros((1, HORIZON, N_X)))
    inputs = cost.observation(trajectory.states[:-1])
    log_density = cost.policy.log_density(inputs, trajectory.controls)
    assert_allclose(point.values(trajectory), cost.scaled.values(trajectory) - log_density)
