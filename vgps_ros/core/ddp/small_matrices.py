# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Products and factorisations of matrices so small that plain compiled loops are the fastest."""

import numpy as np

from vgps_ros.core.compilation import compiled


@compiled
def add_transposed_product(a, b, out, first, width):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds aᵀb to out from row `first` on: `width` columns, or the lower half if that is 0."""
    n = len(b)
    for i in range(first, a.shape[1]):
        columns = width if width > 0 else i + 1
        for k in range(0, n - n % 4, 4):  # four products at once: fewer passes over a row
            f, g, p, q = a[k, i], a[k + 1, i], a[k + 2, i], a[k + 3, i]
            for j in range(columns):
                out[i, j] += f * b[k, j] + g * b[k + 1, j] + p * b[k + 2, j] + q * b[k + 3, j]
        for k in range(n - n % 4, n - n % 2, 2):
            f, g = a[k, i], a[k + 1, i]
            for j in range(columns):
                out[i, j] += f * b[k, j] + g * b[k + 1, j]
        if n % 2:
            f = a[n - 1, i]
            for j in range(columns):
                out[i, j] += f * b[n - 1, j]


@compiled
def solve_in_place(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Overwrites b with a⁻¹b; returns false if a is not positive definite or not finite."""
    n, m = b.shape
    for j in range(n):
        for i in range(j):
            a[j, j] -= a[j, i] ** 2
        if not a[j, j] > 0.0:
            return False
        a[j, j] = np.sqrt(a[j, j])
        for row in range(j + 1, n):
            for i in range(j):
                a[row, j] -= a[row, i] * a[j, i]
            a[row, j] /= a[j, j]
    for j in range(n):
        for i in range(j):
            for column in range(m):
                b[j, column] -= a[j, i] * b[i, column]
        for column in range(m):
            b[j, column] /= a[j, j]
    for j in range(n - 1, -1, -1):
        for i in range(j + 1, n):
            for column in range(m):
                b[j, column] -= a[i, j] * b[i, column]
        for column in range(m):
            b[j, column] /= a[j, j]
    return True
