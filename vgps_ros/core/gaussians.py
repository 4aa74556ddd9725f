# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Closed forms of Gaussian densities, entropies and divergences."""

import numpy as np

from vgps_ros.core.checks import Array


def log_density(deviations: Array, covariances: Array) -> Array:
    """Returns log N(δ; 0, Σ) [nat], shape (...,), for δ (..., n) and covariances (..., n, n)."""
    n = deviations.shape[-1]
    return -0.5 * (
        squared_distance(deviations, covariances)
        + np.linalg.slogdet(covariances)[1]
        + n * np.log(2 * np.pi)
    )


def squared_distance(deviations: Array, covariances: Array) -> Array:
    """Returns the squared Mahalanobis distance δᵀ Σ⁻¹ δ, shape (...,)."""
    precisions = np.linalg.inv(covariances)
    return np.einsum("...i,...ij,...j->...", deviations, precisions, deviations)


def covariance_roots(covariances: Array) -> Array:
    """Returns R with R Rᵀ = Σ, shape (..., n, n), of covariances of the same shape.

    Unlike usual Cholesky factors they exist where Σ is singular, as it is where a coordinate has no
    noise, or where rounding has made its smallest eigenvalue negative: each next column takes the
    coordinate that has most of its variance left, until what is left is rounding.
    """
    from vgps_ros.core.compiled_gaussians import pivoted_roots

    roots = np.empty_like(covariances)
    n = covariances.shape[-1]
    pivoted_roots(covariances.reshape(-1, n, n), roots.reshape(-1, n, n))
    return roots


def entropy(covariances: Array) -> Array:
    """Returns the entropy of N(·, Σ) [nat], shape (...,), for covariances (..., n, n)."""
    n = covariances.shape[-1]
    return 0.5 * (n * np.log(2 * np.pi * np.e) + np.linalg.slogdet(covariances)[1])


def kl_divergence(mean_0: Array, covariance_0: Array, mean_1: Array, covariance_1: Array) -> Array:
    """Returns KL(N_0 ‖ N_1) [nat], shape (...,), for means (..., n) and covariances (..., n, n)."""
    precision = np.linalg.inv(covariance_1)
    difference = mean_1 - mean_0
    trace = np.einsum("...ij,...ji->...", precision, covariance_0)
    distance = np.einsum("...i,...ij,...j->...", difference, precision, difference)
    log_ratio = np.linalg.slogdet(covariance_1)[1] - np.linalg.slogdet(covariance_0)[1]
    return 0.5 * (trace + distance - mean_0.shape[-1] + log_ratio)
