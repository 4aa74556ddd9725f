# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Vectors of spatial algebra in compiled loops: six numbers, as rows of arrays.

Motions are (turn, shift), and forces (torque, force), about an origin that they share. The cross
products are those of Featherstone (2008): V × S of motions, V ×* F of a force that moves along V.
"""

from vgps_ros.core.compilation import compiled_part

# Numba takes a tenth of a second to compile each access to a matrix, so rows are read at once.


@compiled_part
def row3(a, i):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns the first three numbers of a row."""
    return a[i, 0], a[i, 1], a[i, 2]


@compiled_part
def row(a, i):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns six numbers of a row."""
    return a[i, 0], a[i, 1], a[i, 2], a[i, 3], a[i, 4], a[i, 5]


@compiled_part
def put_row(out, k, p, q, r, s, t, u):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes six numbers of a row."""
    out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4], out[k, 5] = p, q, r, s, t, u


@compiled_part
def add_to_row(out, k, size, p, q, r, s, t, u):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds `size` times six numbers to a row."""
    x, y, z, d, e, f = row(out, k)
    x, y, z, d, e, f = (
        x + size * p,
        y + size * q,
        z + size * r,
        d + size * s,
        e + size * t,
        f + size * u,
    )
    put_row(out, k, x, y, z, d, e, f)


@compiled_part
def cross(a, i, b, j, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the motion a_i × b_j."""
    p, q, r, s, t, u = row(a, i)
    x, y, z, d, e, f = row(b, j)
    first, second, third = (
        q * f - r * e + t * z - u * y,
        r * d - p * f + u * x - s * z,
        p * e - q * d,
    )
    put_row(
        out, k, q * z - r * y, r * x - p * z, p * y - q * x, first, second, third + s * y - t * x
    )


@compiled_part
def add_cross_force(a, i, b, j, size, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds `size` times the change a_i ×* b_j of a wrench b_j that moves along a_i."""
    p, q, r, s, t, u = row(a, i)
    x, y, z, d, e, f = row(b, j)
    first, second, third = (
        q * z - r * y + t * f - u * e,
        r * x - p * z + u * d - s * f,
        p * y - q * x,
    )
    third += s * e - t * d
    add_to_row(out, k, size, first, second, third, q * f - r * e, r * d - p * f, p * e - q * d)


@compiled_part
def inertia_of(inertia, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns I_b: xx, yy, zz, xy, xz, yz, m c and m."""
    xx, yy, zz, xy, xz, yz = row(inertia, b)
    return xx, yy, zz, xy, xz, yz, inertia[b, 6], inertia[b, 7], inertia[b, 8], inertia[b, 9]


@compiled_part
def put_inertia(inertia, b, a, i, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes I_b a_i."""
    p, q, r, s, t, u = row(a, i)
    xx, yy, zz, xy, xz, yz, x, y, z, m = inertia_of(inertia, b)
    first, second = (
        xx * p + xy * q + xz * r + y * u - z * t,
        xy * p + yy * q + yz * r + z * s - x * u,
    )
    third = xz * p + yz * q + zz * r + x * t - y * s
    fourth, fifth, sixth = m * s + q * z - r * y, m * t + r * x - p * z, m * u + p * y - q * x
    put_row(out, k, first, second, third, fourth, fifth, sixth)


@compiled_part
def add_curl(n, l, b, a, i, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds B_b a_i = (N w, 2 w × l)."""
    p, q, r = row3(a, i)
    x, y, z = row3(l, b)
    for m in range(3):
        out[k, m] += n[b, 3 * m] * p + n[b, 3 * m + 1] * q + n[b, 3 * m + 2] * r
    first, second, third = q * z - r * y, r * x - p * z, p * y - q * x
    add_to_row(out, k, 2.0, 0.0, 0.0, 0.0, first, second, third)


@compiled_part
def dot(a, i, b, j):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns a_i · b_j."""
    total = 0.0
    for k in range(6):
        total += a[i, k] * b[j, k]
    return total


@compiled_part
def dot3(a, i, b, j):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns a_i · b_j of their first three numbers."""
    total = 0.0
    for k in range(3):
        total += a[i, k] * b[j, k]
    return total
