"""The backward pass of iterative LQR (section 4).

In deviations from a trajectory, it solves the linear-quadratic problem

    minimise  Σ_t  c_xᵀ δx + c_uᵀ δu + ½ δxᵀ c_xx δx + ½ δuᵀ c_uu δu + δuᵀ c_ux δx
    subject to  δx_{t+1} = f_x δx + f_u δu,

by the local policy δu = k + K δx. Quu, the Hessian of the cost to go in u, is the precision of the
maximum-entropy policy π_G(u|x) = N(ū + k + K δx, Quu⁻¹). The state regularisation μ penalises the
next state's deviation when k and K are computed; the cost to go, V, is that of the policy which is
really followed. In NumPy, what is compiled below reads:

    k, gains = np.zeros((horizon, n_u)), np.zeros((horizon, n_u, n_x))
    q_uu, slope, curvature = np.zeros((horizon, n_u, n_u)), 0.0, 0.0
    v_x, v_xx = np.zeros(n_x), np.zeros((n_x, n_x))
    for t in reversed(range(horizon)):
        a, b = f_x[t], f_u[t]
        q_x = c_x[t] + a.T @ v_x
        q_u = c_u[t] + b.T @ v_x
        q_xx = c_xx[t] + a.T @ v_xx @ a
        q_ux = c_ux[t] + b.T @ v_xx @ a
        q_uu[t] = c_uu[t] + b.T @ v_xx @ b
        regularized = q_uu[t] + mu * b.T @ b
        k[t] = -np.linalg.solve(regularized, q_u)
        gains[t] = -np.linalg.solve(regularized, q_ux + mu * b.T @ a)
        v_x = q_x + gains[t].T @ (q_u + q_uu[t] @ k[t]) + q_ux.T @ k[t]
        v_xx = q_xx + gains[t].T @ (q_ux + q_uu[t] @ gains[t]) + q_ux.T @ gains[t]
        slope += k[t] @ q_u
        curvature += k[t] @ q_uu[t] @ k[t]
"""

from dataclasses import dataclass
from typing import cast

import numpy as np

from vgps_ros.core.compilation import compiled
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.records import Array, CostExpansion, LinearDynamics


@dataclass(frozen=True)
class LocalPolicy:
    """Result of a backward pass.

    Attributes:
        feedforward: k_t, shape (T, n_u), [N·m].
        gains: K_t, shape (T, n_u, n_x).
        q_uu: unregularised Quu_t, shape (T, n_u, n_u).
        slope: Σ kᵀQ_u, by which the model's cost changes per unit of a small step at μ = 0; at
            μ > 0 only the expected reduction of a full step is exact.
        curvature: Σ kᵀ Quu k.
        complete: false if a regularised Quu was not positive definite; no other value counts then.
    """

    feedforward: Array
    gains: Array
    q_uu: Array
    slope: float
    curvature: float
    complete: bool

    def expected_reduction(self, step_size: float) -> float:
        """Returns by how much the quadratic model expects a step to lower the cost."""
        return -step_size * self.slope - 0.5 * step_size**2 * self.curvature

    def control_covariances(self) -> Array:
        """Returns Quu⁻¹, shape (T, n_u, n_u), the covariance of π_G.

        Raises:
            DivergenceError: an unregularised Quu has no inverse that is a covariance.
        """
        try:
            np.linalg.cholesky(self.q_uu)
            covariances = np.linalg.inv(self.q_uu)
        except np.linalg.LinAlgError:
            covariances = np.full_like(self.q_uu, np.nan)
        if not np.isfinite(covariances).all():
            raise DivergenceError(
                "Quu has no inverse that is a covariance: raise alpha (cost_scale), or give "
                "controls more weight in the cost.",
                "indefinite_quu",
            )
        return cast(Array, covariances)


def backward_pass(
    dynamics: LinearDynamics, cost: CostExpansion, regularization: float = 0.0
) -> LocalPolicy:
    """Computes the local policy of a linear-quadratic model (section 4).

    Args:
        dynamics: f_x, f_u of each step.
        cost: expansion of each step's cost; the state after the last step has no cost.
        regularization: μ, at least 0.
    """
    k, gains, q_uu, slope, curvature, complete = _recursion(
        dynamics.f_x,
        dynamics.f_u,
        cost.c_x,
        cost.c_u,
        cost.c_xx,
        cost.c_uu,
        cost.c_ux,
        float(regularization),
    )
    return LocalPolicy(k, gains, q_uu, slope, curvature, complete)


@compiled
def _recursion(f_x, f_u, c_x, c_u, c_xx, c_uu, c_ux, mu):  # type: ignore[no-untyped-def]  # pragma: no cover
    horizon, n_x, n_u = f_u.shape
    k = np.zeros((horizon, n_u))
    gains = np.zeros((horizon, n_u, n_x))
    quu = np.zeros((horizon, n_u, n_u))
    v_x, v_xx = np.zeros(n_x), np.zeros((n_x, n_x))
    slope, curvature = 0.0, 0.0
    # Matrices this small are multiplied fastest in plain loops, into memory allocated once.
    # Indices run over z = (x, u): f_z = [f_x f_u]; only the lower half of Q_zz is computed.
    n_z = n_x + n_u
    f_z, vf = np.empty((n_x, n_z)), np.empty((n_x, n_z))
    q_z, q_zz, ff = np.empty(n_z), np.empty((n_z, n_z)), np.zeros((n_z, n_z))
    left, right = np.empty((n_u, n_u)), np.empty((n_u, 1 + n_x))
    upper, lower = np.empty((2 * n_u, n_x)), np.empty((2 * n_u, n_x))
    for t in range(horizon - 1, -1, -1):
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
        _add_transposed_product(v_xx, f_z, vf, 0, n_z)
        _add_transposed_product(f_z, vf, q_zz, 0, 0)
        if mu > 0.0:
            ff[n_x:] = 0.0
            _add_transposed_product(f_z, f_z, ff, n_x, 0)

        # Solve (Quu + μ BᵀB) [k K] = −[Q_u  Q_ux + μ BᵀA] by a Cholesky factorisation.
        for i in range(n_u):
            row = n_x + i
            for j in range(i + 1):
                left[i, j] = q_zz[row, n_x + j] + mu * ff[row, n_x + j]
            right[i, 0] = -q_z[row]
            for j in range(n_x):
                right[i, 1 + j] = -(q_zz[row, j] + mu * ff[row, j])
        if not _solve_in_place(left, right):
            return k, gains, quu, slope, curvature, False
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
        _add_transposed_product(upper, lower, q_zz, 0, 0)
        for i in range(n_x):
            for j in range(i + 1):
                v_xx[i, j] = v_xx[j, i] = q_zz[i, j]
    return k, gains, quu, slope, curvature, True


@compiled
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


@compiled
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
