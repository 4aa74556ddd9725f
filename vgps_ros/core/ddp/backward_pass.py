# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The backward pass of iterative LQR (section 4).

In deviations from a trajectory, it solves the linear-quadratic problem

    minimise  Σ_t  c_xᵀ δx + c_uᵀ δu + ½ δxᵀ c_xx δx + ½ δuᵀ c_uu δu + δuᵀ c_ux δx
    subject to  δx_{t+1} = f_x δx + f_u δu + d,    low ≤ ū + k ≤ high,

by the local policy δu = k + K δx. Quu, the Hessian of the cost to go in u, is the precision of the
maximum-entropy policy π_G(u|x) = N(ū + k + K δx, Quu⁻¹). The state regularisation μ penalises the
next state's deviation when k and K are computed; the cost to go, V, is that of the policy which is
really followed. A gap d is there where the trajectory does not satisfy the dynamics (`forward_pass`
closes it). A control that a bound holds against the gradient is clamped: k takes it to the bound,
its row of K is the bound's derivative by the state (zero for a limit that stays where it is, but
that of a servo's greatest force moves with its joint), and π_G has no noise in it.

The k of one step is the solution of

    minimise  ½ kᵀ H k + gᵀ k   subject to  low ≤ k ≤ high,

by projected Newton steps, after Tassa, Mansard and Todorov (Control-limited DDP, ICRA 2014): each
one solves for the coordinates that are free, those which no bound holds against the gradient, and
projects onto the bounds. It ends at the minimiser itself, without a tolerance: where a whole step
has stayed within the bounds, and the same coordinates are free after it.

In NumPy, with `minimum` for that problem, what is compiled below reads:

    k, gains = np.zeros((horizon, n_u)), np.zeros((horizon, n_u, n_x))
    free = np.ones((horizon, n_u), bool)
    q_uu, slope, curvature = np.zeros((horizon, n_u, n_u)), 0.0, 0.0
    v_x, v_xx = np.zeros(n_x), np.zeros((n_x, n_x))
    for t in reversed(range(horizon)):
        a, b = f_x[t], f_u[t]
        v_x = v_x + v_xx @ gaps[t]
        q_x = c_x[t] + a.T @ v_x
        q_u = c_u[t] + b.T @ v_x
        q_xx = c_xx[t] + a.T @ v_xx @ a
        q_ux = c_ux[t] + b.T @ v_xx @ a
        q_uu[t] = c_uu[t] + b.T @ v_xx @ b
        regularized = q_uu[t] + mu * b.T @ b
        k[t] = minimum(regularized, q_u, low[t], high[t])
        f = free[t] = (low[t] < k[t]) & (k[t] < high[t])
        gains[t, ~f] = np.where(k[t] <= low[t], slopes[0, t].T, slopes[1, t].T).T[~f]
        coupled = q_ux + mu * b.T @ a + regularized[:, ~f] @ gains[t, ~f]
        gains[t, f] = -np.linalg.solve(regularized[f][:, f], coupled[f])
        v_x = q_x + gains[t].T @ (q_u + q_uu[t] @ k[t]) + q_ux.T @ k[t]
        v_xx = q_xx + gains[t].T @ (q_ux + q_uu[t] @ gains[t]) + q_ux.T @ gains[t]
        slope += k[t] @ q_u
        curvature += k[t] @ q_uu[t] @ k[t]
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compile_at_first_call, compiled_part
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.records import Array, CostExpansion, LinearDynamics


@dataclass(frozen=True)
class LocalPolicy:
    """Result of a backward pass.

    Attributes:
        feedforward: k_t, shape (T, n_u), [N·m].
        gains: K_t, shape (T, n_u, n_x).
        q_uu: unregularised Quu_t, shape (T, n_u, n_u).
        free: whether each control may move; its limit clamps it otherwise, shape (T, n_u).
        slope: Σ kᵀQ_u, by which the model's cost changes per unit of a small step at μ = 0; at
            μ > 0 only the expected reduction of a full step is exact.
        curvature: Σ kᵀ Quu k.
        complete: false if a regularised Quu was not positive definite; no other value counts then.
    """

    feedforward: Array
    gains: Array
    q_uu: Array
    free: NDArray[np.bool_]
    slope: float
    curvature: float
    complete: bool

    def expected_reduction(self, step_size: float) -> float:
        """Returns by how much the quadratic model expects a step to lower the cost."""
        return -step_size * self.slope - 0.5 * step_size**2 * self.curvature

    def control_covariances(self) -> Array:
        """Returns the covariance of π_G, shape (T, n_u, n_u).

        It is Quu⁻¹ over the free controls, and zero in the rows and columns of clamped ones: the
        robot would cut the noise off at the limit, so the policy must not learn it.

        Raises:
            DivergenceError: an unregularised Quu has no inverse that is a covariance.
        """
        both = self.free[:, :, None] & self.free[:, None, :]
        q_uu = np.where(both, self.q_uu, np.eye(self.free.shape[1]))
        try:
            # A product with its own transpose is symmetric, however nearly singular Quu is.
            root = np.linalg.inv(np.linalg.cholesky(q_uu))
            covariances = np.where(both, np.swapaxes(root, 1, 2) @ root, 0.0)
        except np.linalg.LinAlgError:
            covariances = np.full_like(q_uu, np.nan)
        if not np.isfinite(covariances).all():
            raise DivergenceError(
                "Quu has no inverse that is a covariance: raise alpha (cost_scale), or give "
                "controls more weight in the cost.",
                "indefinite_quu",
            )
        return cast(Array, covariances)


def backward_pass(
    dynamics: LinearDynamics,
    cost: CostExpansion,
    regularization: float = 0.0,
    bounds: tuple[Array, Array] | None = None,
    gaps: Array | None = None,
    slopes: Array | None = None,
) -> LocalPolicy:
    """Computes the local policy of a linear-quadratic model (section 4).

    Args:
        dynamics: f_x, f_u of each step.
        cost: expansion of each step's cost; the state after the last step has no cost.
        regularization: μ, at least 0.
        bounds: the lowest and the highest k of each step, shapes (T, n_u); None for none.
        gaps: d of each step, shape (T, n_dx); None for none.
        slopes: derivatives of both bounds by the state, shape (2, T, n_u, n_dx); None for zero.
    """
    shape = cost.c_u.shape
    low, high = bounds or (np.full(shape, -np.inf), np.full(shape, np.inf))
    k, gains, q_uu, free, slope, curvature, complete = _recursion(
        dynamics.f_x,
        dynamics.f_u,
        cost.c_x,
        cost.c_u,
        cost.c_xx,
        cost.c_uu,
        cost.c_ux,
        float(regularization),
        low,
        high,
        np.empty((0, cost.c_x.shape[1])) if gaps is None else gaps,
        np.empty((0, *cost.c_ux.shape)) if slopes is None else slopes,
    )
    return LocalPolicy(k, gains, q_uu, free, slope, curvature, complete)


_FROM_TOP, _LOWER_HALF = np.int64(0), np.int64(0)  # see `_add_transposed_product`


@compile_at_first_call
def _recursion(  # type: ignore[no-untyped-def]  # pragma: no cover
    f_x, f_u, c_x, c_u, c_xx, c_uu, c_ux, mu, low, high, gaps, slopes
):
    """Does what the module's docstring writes in NumPy.

    It is one long loop since all of a step works on the same arrays, which are allocated once: each
    part would have to be handed a dozen of them.
    """
    horizon, n_x, n_u = f_u.shape
    k = np.zeros((horizon, n_u))
    gains = np.zeros((horizon, n_u, n_x))
    quu = np.zeros((horizon, n_u, n_u))
    free = np.ones((horizon, n_u), np.bool_)
    v_x, v_xx = np.zeros(n_x), np.zeros((n_x, n_x))
    slope, curvature = 0.0, 0.0
    # Matrices this small are multiplied fastest in plain loops, into memory allocated once.
    # Indices run over z = (x, u): f_z = [f_x f_u]; only the lower half of Q_zz is computed.
    n_z = n_x + n_u
    f_z, vf = np.empty((n_x, n_z)), np.empty((n_x, n_z))
    q_z, q_zz, ff = np.empty(n_z), np.empty((n_z, n_z)), np.zeros((n_z, n_z))
    left, right = np.empty((n_u, n_u)), np.empty((n_u, 1 + n_x))
    regularized = np.empty((n_u, n_u))
    upper, lower = np.empty((2 * n_u, n_x)), np.empty((2 * n_u, n_x))
    for t in range(horizon - 1, -1, -1):
        for i in range(n_x if len(gaps) else 0):
            for j in range(n_x):
                v_x[i] += v_xx[i, j] * gaps[t, j]
        for i in range(n_x):
            q_z[i] = c_x[t, i]
            for j in range(i + 1):
                q_zz[i, j] = c_xx[t, i, j]
            for j in range(n_x):
                f_z[i, j] = f_x[t, i, j]
            for j in range(n_u):
                f_z[i, n_x + j] = f_u[t, i, j]
            for j in range(n_z):
                vf[i, j] = 0.0
        for i in range(n_u):
            q_z[n_x + i] = c_u[t, i]
            for j in range(n_x):
                q_zz[n_x + i, j] = c_ux[t, i, j]
            for j in range(i + 1):
                q_zz[n_x + i, n_x + j] = c_uu[t, i, j]
        for i in range(n_x):
            for j in range(n_z):
                q_z[j] += f_z[i, j] * v_x[i]
        _add_transposed_product(v_xx, f_z, vf, _FROM_TOP, n_z)
        _add_transposed_product(f_z, vf, q_zz, _FROM_TOP, _LOWER_HALF)
        if mu > 0.0:
            ff[n_x:] = 0.0
            _add_transposed_product(f_z, f_z, ff, n_x, _LOWER_HALF)

        # Solve (Quu + μ BᵀB) [k K] = −[Q_u  Q_ux + μ BᵀA] by a Cholesky factorisation; where k
        # reaches a bound, it is the start of the search for the k within the bounds.
        for i in range(n_u):
            row = n_x + i
            for j in range(i + 1):
                left[i, j] = q_zz[row, n_x + j] + mu * ff[row, n_x + j]
                regularized[i, j] = regularized[j, i] = left[i, j]
            right[i, 0] = -q_z[row]
            for j in range(n_x):
                right[i, 1 + j] = -(q_zz[row, j] + mu * ff[row, j])
        if not _solve_in_place(left, right):
            return k, gains, quu, free, slope, curvature, False
        is_outside = False
        for i in range(n_u):
            is_outside |= right[i, 0] <= low[t, i] or right[i, 0] >= high[t, i]
        if is_outside:
            for i in range(n_u):
                k[t, i] = right[i, 0]
            minimize_in_box(regularized, q_z[n_x:], low[t], high[t], k[t], free[t])
            for i in range(n_u):
                row = n_x + i
                right[i, 0] = 0.0
                for j in range(n_x):
                    right[i, 1 + j] = -(q_zz[row, j] + mu * ff[row, j])
            for m in range(n_u if len(slopes) else 0):
                if free[t, m]:
                    continue
                side = 0 if k[t, m] <= low[t, m] else 1
                for j in range(n_x):
                    gains[t, m, j] = slopes[side, t, m, j]
                for i in range(n_u):
                    for j in range(n_x):
                        right[i, 1 + j] -= regularized[i, m] * gains[t, m, j]
            _solve_free(regularized, free[t], left, right)
            for m in range(n_u):
                right[m, 0] = k[t, m]
                if not free[t, m]:
                    for j in range(n_x):
                        right[m, 1 + j] = gains[t, m, j]
        for i in range(n_u):
            k[t, i] = right[i, 0]
            for j in range(i + 1):
                quu[t, i, j] = quu[t, j, i] = q_zz[n_x + i, n_x + j]
            for j in range(n_x):
                gains[t, i, j] = upper[i, j] = lower[n_u + i, j] = right[i, 1 + j]
                lower[i, j] = upper[n_u + i, j] = q_zz[n_x + i, j]

        for j in range(n_x):
            v_x[j] = q_z[j]
        for i in range(n_u):
            quu_k = 0.0
            for m in range(n_u):
                quu_k += quu[t, i, m] * k[t, m]
                for j in range(n_x):
                    lower[i, j] += quu[t, i, m] * gains[t, m, j]
            slope += k[t, i] * q_z[n_x + i]
            curvature += k[t, i] * quu_k
            for j in range(n_x):
                v_x[j] += gains[t, i, j] * (quu_k + q_z[n_x + i]) + upper[n_u + i, j] * k[t, i]
        _add_transposed_product(upper, lower, q_zz, _FROM_TOP, _LOWER_HALF)
        for i in range(n_x):
            for j in range(i + 1):
                v_xx[i, j] = v_xx[j, i] = q_zz[i, j]
    return k, gains, quu, free, slope, curvature, True


_MOST_STEPS = 100  # a few are usual; rounding may keep a degenerate problem from ending by itself
_SHORTEST = 1e-10  # a step that must be shorter than this share brings nothing but rounding
_SUFFICIENT = 0.1  # share of the gradient's promise that a step must keep


@compile_at_first_call
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
        _solve_free(hessian, free, left, step)
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
        for i in range(n):
            k[i] = moved[i]


@compiled_part
def _solve_free(hessian, free, left, right):  # type: ignore[no-untyped-def]  # pragma: no cover
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
    return _solve_in_place(left, right)


@compiled_part
def _add_transposed_product(a, b, out, first, width):  # type: ignore[no-untyped-def]  # pragma: no cover
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


@compiled_part
def _solve_in_place(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
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
