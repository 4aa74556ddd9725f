# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from vgps_ros.core.gaussians import covariance_roots, entropy, kl_divergence, log_density


def test_entropy_is_scipys(random_covariances):
    covariances = random_covariances(5, 3)
    expected = [multivariate_normal(cov=c).entropy() for c in covariances]
    assert_allclose(entropy(covariances), expected, rtol=1e-12)
    assert_allclose(entropy(covariances.reshape(5, 1, 3, 3))[:, 0], expected, rtol=1e-12)


def test_divergence_of_scalars_is_the_textbook_formula():
    found = kl_divergence(np.array([1.0]), np.array([[4.0]]), np.array([3.0]), np.array([[9.0]]))
    assert_allclose(found, np.log(3 / 2) + (4 + (1 - 3) ** 2) / (2 * 9) - 0.5, rtol=1e-14)


def test_divergence_agrees_with_monte_carlo(random_covariances, rng):
    (cov_0, cov_1), (mean_0, mean_1) = random_covariances(2, 3), rng.standard_normal((2, 3))
    p, q = multivariate_normal(mean_0, cov_0), multivariate_normal(mean_1, cov_1)
    x = p.rvs(200_000, random_state=rng)
    log_ratios = p.logpdf(x) - q.logpdf(x)
    found = kl_divergence(mean_0, cov_0, mean_1, cov_1)
    assert found == pytest.approx(
        log_ratios.mean(), abs=5 * log_ratios.std() / np.sqrt(log_ratios.size)
    )


def test_divergence_is_zero_between_equals_and_positive_otherwise(random_covariances, rng):
    covariances, means = random_covariances(6, 4), rng.standard_normal((6, 4))
    assert_allclose(kl_divergence(means, covariances, means, covariances), 0.0, atol=1e-9)
    assert np.all(kl_divergence(means, covariances, means[::-1], covariances[::-1]) > 0)


def test_log_density_is_scipys(rng, random_covariances):
    covariances, deviations = random_covariances(4, 3), rng.standard_normal((4, 3))
    expected = [
        multivariate_normal(np.zeros(3), c).logpdf(d)
        for c, d in zip(covariances, deviations, strict=True)
    ]
    assert_allclose(log_density(deviations, covariances), expected, rtol=1e-10)
    batch = log_density(deviations.reshape(1, 2, 2, 3), covariances.reshape(2, 2, 3, 3))
    assert_allclose(batch.ravel(), expected, rtol=1e-10)


def test_roots_of_covariances_exist_where_they_are_singular_or_rounded():
    rng = np.random.default_rng(0)
    full = rng.standard_normal((3, 4, 4))
    covariances = full @ np.swapaxes(full, 1, 2)
    covariances[1, 2] = covariances[1, :, 2] = 0.0
    vectors = np.linalg.qr(full[2]).Q
    covariances[2] = vectors @ np.diag([-1e-7, 1.0, 2.0, 3.0]) @ vectors.T
    roots = covariance_roots(covariances)
    np.testing.assert_allclose(roots @ np.swapaxes(roots, 1, 2), covariances, rtol=0, atol=2e-7)
    np.testing.assert_allclose(roots[1, 2], 0.0, atol=1e-12)
