# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compiled loops over the covariances of a motion; a robot's computer does without them."""

import numpy as np

from vgps_ros.core.compilation import compile_at_first_call

# Variance that is left to a coordinate, as a share of its own, below which it is rounding.
_ROUNDING = 1e-11


@compile_at_first_call
def pivoted_roots(covariances, roots):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes R with R Rᵀ = Σ for covariances (N, n, n); see `gaussians.covariance_roots`."""
    n = roots.shape[1]
    column = np.empty(n)
    for covariance, root in zip(covariances, roots):  # noqa: B905 - numba has no strict
        left, is_open = covariance.copy(), np.ones(n, dtype=np.bool_)
        root[:] = 0.0 * covariance  # what is not finite stays so
        for k in range(n):
            pivot, most = -1, _ROUNDING
            for i in range(n):
                if is_open[i] and left[i, i] > most * covariance[i, i]:
                    pivot, most = i, left[i, i] / covariance[i, i]
            if pivot < 0:
                break
            scale = 1.0 / np.sqrt(left[pivot, pivot])
            for i in range(n):
                root[i, k] = column[i] = scale * left[pivot, i] if is_open[i] else 0.0
            is_open[pivot] = False
            for i in range(n):
                if is_open[i]:
                    for j in range(n):
                        left[i, j] -= column[i] * column[j]


@compile_at_first_call
def propagate(initial, closed_loop, noise, limit, sigma):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes Σ_1 … Σ_{T+1}: [f_x f_u] [Σ ΣKᵀ; KΣ Quu⁻¹ + KΣKᵀ] [f_x f_u]ᵀ + Σ_f, multiplied out.

    Coordinates are scaled down to their limit, and keep their correlations.
    """
    here, scale = initial, np.empty(len(limit))
    for t in range(len(sigma)):
        for i in range(len(limit)):
            std = np.sqrt(here[i, i])
            scale[i] = 1.0 if std <= limit[i] else limit[i] / std
        for i in range(len(limit)):
            for j in range(len(limit)):
                sigma[t, i, j] = scale[i] * scale[j] * here[i, j]
        if t < len(noise):
            here = closed_loop[t] @ sigma[t] @ closed_loop[t].T + noise[t]
