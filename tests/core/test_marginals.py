# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.marginals import (
    MarginalSettings,
    Spread,
    control_log_density,
    control_means,
    sample_deviations,
    sample_joint_deviations,
    sample_rollout_noise,
    state_covariances,
    with_clamped_variances,
)
from vgps_ros.core.records import LinearDynamics

COUNT = 200_000


def assert_is_covariance_of(covariance, samples):
    """Compares with samples (N, n) of zero mean, within five standard errors."""
    variances = np.diagonal(covariance)
    error = np.sqrt((np.outer(variances, variances) + covariance**2) / len(samples))
    assert np.all(np.abs(samples.T @ samples / len(samples) - covariance) <= 5 * error + 1e-7)


@pytest.fixture
def spread(rng):
    return Spread(rng.uniform(0.5, 1, 4), rng.uniform(0.2, 0.5, 4), np.full(4, np.inf))


def covariances_of(q, spread):
    return state_covariances(q.linear_dynamics, q.gains, q.control_covariances, spread)


def test_covariances_agree_with_monte_carlo(random_distribution, spread, rng):
    q = random_distribution(horizon=5)
    q = dataclasses.replace(q, gains=0.3 * q.gains)
    found = covariances_of(q, spread)
    dx = spread.initial_std * rng.standard_normal((COUNT, 4))
    assert_is_covariance_of(found[0], dx)
    for t in range(5):
        noise = rng.multivariate_normal(np.zeros(2), q.control_covariances[t], COUNT)
        du = dx @ q.gains[t].T + noise
        dx = dx @ q.linear_dynamics.f_x[t].T + du @ q.linear_dynamics.f_u[t].T
        dx += spread.dynamics_std * rng.standard_normal(dx.shape)
        assert_is_covariance_of(found[t + 1], dx)


def test_covariances_are_symmetric_and_positive(random_distribution, spread):
    sigma = covariances_of(random_distribution(), spread)
    assert_allclose(sigma, np.swapaxes(sigma, 1, 2), rtol=1e-12)
    assert np.all(np.linalg.eigvalsh(sigma) > 0)


def test_recursion_equals_the_papers_block_form(random_distribution, spread):
    q = random_distribution()
    found = covariances_of(q, spread)
    for t in range(q.mean.horizon):
        f = np.hstack([q.linear_dynamics.f_x[t], q.linear_dynamics.f_u[t]])
        sigma, gain = found[t], q.gains[t]
        joint = np.block(
            [
                [sigma, sigma @ gain.T],
                [gain @ sigma, q.control_covariances[t] + gain @ sigma @ gain.T],
            ]
        )
        expected = f @ joint @ f.T + np.diag(spread.dynamics_std**2)
        assert_allclose(found[t + 1], expected, rtol=1e-10)


def test_cap_limits_deviations_and_keeps_correlations(random_distribution, spread):
    q = random_distribution(horizon=1)
    free = covariances_of(q, spread)
    limit = np.array([0.4, np.inf, 1e-3, np.inf])
    capped = covariances_of(q, dataclasses.replace(spread, std_limit=limit))
    assert_allclose(np.sqrt(np.diagonal(capped[0])), np.minimum(spread.initial_std, limit))
    stds = np.sqrt(np.diagonal(capped[1]))
    assert_allclose(stds[[0, 2]], limit[[0, 2]])

    # After one step from the capped start, without a cap of its own.
    start = dataclasses.replace(spread, initial_std=np.minimum(spread.initial_std, limit))
    free = covariances_of(q, start)[1]
    free_stds = np.sqrt(np.diagonal(free))
    assert_allclose(stds[[1, 3]], free_stds[[1, 3]])
    assert_allclose(capped[1] / np.outer(stds, stds), free / np.outer(free_stds, free_stds))


@pytest.mark.parametrize("singular", [False, True])
def test_drawn_deviations_have_the_covariances(random_distribution, rng, singular):
    q = random_distribution(horizon=3)
    if singular:  # no spread in one coordinate, and two that move as one
        mix = np.diag([1.0, 0.0, 1.0, 1.0])
        mix[3] = mix[2]
        sigma = mix @ q.state_covariances @ mix.T
        q = dataclasses.replace(q, state_covariances=sigma)
    deviations = sample_deviations(q, COUNT, rng)
    assert deviations.shape == (COUNT, 3, 4)
    for t in range(3):
        # Samples come in pairs ±δ: only half of them are independent.
        assert_is_covariance_of(q.state_covariances[t], deviations[: COUNT // 2, t])


def test_drawn_deviations_come_in_pairs(random_distribution, rng):
    q = random_distribution()
    deviations = sample_deviations(q, 10, rng)
    assert_array_equal(deviations[:5], -deviations[5:])
    assert sample_deviations(q, 7, rng).shape == (7, 6, 4)
    assert np.unique(np.abs(deviations[:, 0, 0])).size == 5


def test_states_and_controls_are_drawn_together_in_pairs(random_distribution, rng):
    """δu = K δx + noise of covariance Quu⁻¹."""
    q = random_distribution(horizon=3)
    deviations, controls = sample_joint_deviations(q, COUNT, rng)
    half = COUNT // 2
    assert_array_equal(deviations[:half], -deviations[half:])
    assert_array_equal(controls[:half], -controls[half:])
    for t in range(3):
        noise = controls[:half, t] - deviations[:half, t] @ q.gains[t].T
        assert_is_covariance_of(q.control_covariances[t], noise)
        scale = np.sqrt(
            np.outer(np.diagonal(q.control_covariances[t]), q.state_covariances[t].diagonal())
        )
        assert np.all(np.abs(noise.T @ deviations[:half, t] / half) < 5 * scale / np.sqrt(half))


def test_only_controls_without_noise_are_given_a_variance():
    free = np.array([[4.0, 1.0], [1.0, 9.0]])
    clamped = np.array([[0.0, 0.0], [0.0, 9.0]])
    given = with_clamped_variances(
        np.stack([free, clamped, np.zeros((2, 2))]), np.array([2.0, 3.0])
    )
    assert_array_equal(given, [free, np.diag([2.0, 9.0]), np.diag([2.0, 3.0])])
    assert_array_equal(with_clamped_variances(clamped[None], 0.5), [np.diag([0.5, 9.0])])


def test_rollout_noise_has_the_control_covariances(random_distribution, rng):
    q = random_distribution(horizon=3)
    noise = sample_rollout_noise(q, COUNT, rng)
    for t in range(3):
        assert_is_covariance_of(q.control_covariances[t], noise[:, t])


def test_control_means_follow_the_gains(random_distribution, rng):
    q = random_distribution()
    deviations = sample_deviations(q, 2, rng)
    found = control_means(q, deviations)
    for t in range(6):
        expected = [q.mean.controls[t] + q.gains[t] @ delta for delta in deviations[:, t]]
        assert_allclose(found[:, t], expected, rtol=1e-12)


def test_density_of_a_control_is_that_of_the_local_policy(random_distribution, rng):
    q = random_distribution(horizon=3)
    deviations, controls = rng.standard_normal((2, 3, 4)), rng.standard_normal((2, 3, 2))
    found = control_log_density(q, deviations, controls)
    for s, t in np.ndindex(2, 3):
        mean = q.mean.controls[t] + q.gains[t] @ deviations[s, t]
        expected = multivariate_normal(mean, q.control_covariances[t]).logpdf(controls[s, t])
        assert_allclose(found[s, t], expected, rtol=1e-9)


def test_marginals_of_which_rounding_leaves_nothing_are_named_with_the_step():
    """Gains of 10⁹ that read directions in which the state hardly varies: 0 · 10¹⁸."""
    rng = np.random.default_rng(0)
    varied, *others = np.linalg.qr(rng.standard_normal((5, 5)))[0]
    f_x = np.array([np.outer(varied, np.eye(5)[0]), np.zeros((5, 5))])
    gains = np.array([np.zeros((5, 5)), 1e9 * rng.standard_normal((5, 4)) @ others])
    linear = LinearDynamics(f_x, np.tile(np.eye(5), (2, 1, 1)))
    noise = np.array([np.zeros((5, 5)), 100.0 * np.eye(5)])
    start = Spread(np.eye(5)[0], np.zeros(5), np.full(5, np.inf))
    with pytest.raises(
        DivergenceError, match=r"rounding at step 2 of 2: the gains reach 1e\+09"
    ) as caught:
        state_covariances(linear, gains, noise, start)
    assert caught.value.status == "exploding_marginals"


def test_marginals_that_explode_are_named_with_the_step():
    """Σ_t = 0.1² · 4^t passes the bound of 10⁶ in the 24th step."""
    linear = LinearDynamics(np.tile(2 * np.eye(2), (200, 1, 1)), np.zeros((200, 2, 1)))
    noise = Spread(np.full(2, 0.1), np.zeros(2), np.full(2, np.inf))
    with pytest.raises(DivergenceError, match=r"explode: at step 24 of 200.*Raise") as caught:
        state_covariances(linear, np.zeros((200, 1, 2)), np.ones((200, 1, 1)), noise)
    assert caught.value.status == "exploding_marginals"


def test_settings_widen_what_the_task_names():
    widened = MarginalSettings(initial_std_factor=3.0, velocity_noise=0.02, std_limit_annealing=0.5)
    task_std = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    task_limit = np.array([np.inf, 1.0, 2.0, 4.0, 8.0])
    spread = widened.spread(task_std, task_limit, velocities=slice(2, 4), alpha=0.25)
    assert_allclose(spread.initial_std, [0.0, 0.3, 0.6, 0.9, 1.2])
    assert_array_equal(spread.dynamics_std, [0.0, 0.0, 0.02, 0.02, 0.0])  # no activation
    assert_allclose(spread.std_limit, [np.inf, 0.5, 1.0, 2.0, 4.0])
