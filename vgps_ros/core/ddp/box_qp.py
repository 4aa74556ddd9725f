# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The quadratic problem of one step of a backward pass with limits of the controls.

    minimise  ½ kᵀ H k + gᵀ k   subject to  low ≤ k ≤ high,

by projected Newton steps, after Tassa, Mansard and Todorov (Control-limited DDP, ICRA 2014): each
one solves for the coordinates that are free, those which no bound holds against the gradient, and
projects onto the bounds. It ends at the minimiser itself, without a tolerance: where a whole step
has stayed within the bounds, and the same coordinates are free after it.
"""

import numpy as np

from vgps_ros.core.compilation import compiled
from vgps_ros.core.ddp.small_matrices import solve_in_place

_MOST_STEPS = 100  # a few are usual; rounding may keep a degenerate problem from ending by itself
_SHORTEST = 1e-10  # a step that must be shorter than this share brings nothing but rounding
_SUFFICIENT = 0.1  # share of the gradient's promise that a step must keep


@compiled
def minimize_in_box(hessian, gradient, low, high, k, free):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Moves k to the minimiser, and marks the coordinates that are free there.

    Args:
        hessian: H, positive definite, shape (n, n).
        gradient: g, the gradient at zero, shape (n,).
        low: lower bounds, shape (n,).
        high: upper bounds, shape (n,), at least `low`.
        k: where to start, shape (n,); the nearest point within the bounds is taken.
        free: flags, shape (n,); a coordinate whose bounds are equal is never free.
    """
    n = len(k)
    slope, moved = np.empty(n), np.empty(n)
    left, step = np.empty((n, n)), np.empty((n, 1))
    for i in range(n):
        k[i] = min(max(k[i], low[i]), high[i])
    is_whole = False
    for _ in range(_MOST_STEPS):
        is_same = True
        for i in range(n):
            slope[i] = gradient[i]
            for j in range(n):
                slope[i] += hessian[i, j] * k[j]
            is_held = (k[i] <= low[i] and slope[i] > 0.0) or (k[i] >= high[i] and slope[i] < 0.0)
            is_free = low[i] < high[i] and not is_held
            is_same = is_same and is_free == free[i]
            free[i] = is_free
        if is_whole and is_same:
            return
        for i in range(n):
            step[i, 0] = -slope[i]
        solve_free(hessian, free, left, step)
        is_whole, size = False, 1.0
        while size > _SHORTEST:
            promise = change = 0.0
            for i in range(n):
                moved[i] = min(max(k[i] + size * step[i, 0], low[i]), high[i])
            for i in range(n):
                promise += slope[i] * (moved[i] - k[i])
                for j in range(n):
                    change += 0.5 * hessian[i, j] * (moved[i] - k[i]) * (moved[j] - k[j])
            if promise + change <= _SUFFICIENT * promise:
                is_whole = size == 1.0
                for i in range(n):
                    is_whole = is_whole and moved[i] == k[i] + step[i, 0]
                break
            size *= 0.5
        if size <= _SHORTEST:
            return
        k[:] = moved


@compiled
def solve_free(hessian, free, left, right):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Overwrites `right` (n, m) with H⁻¹ of it over free coordinates, and zero in the others' rows.

    `left` (n, n) is overwritten too. Returns false if H is not positive definite there.
    """
    n, m = right.shape
    for i in range(n):
        for j in range(i + 1):
            left[i, j] = hessian[i, j] if free[i] and free[j] else 0.0
        if not free[i]:
            left[i, i] = 1.0
            for j in range(m):
                right[i, j] = 0.0
    return solve_in_place(left, right)
