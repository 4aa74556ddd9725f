"""The backward pass of iterative LQR.

Given f_x, f_u and a quadratic expansion of the cost along a trajectory, it computes backwards in
time the local policy

    g(x) = ū + k + K (x − x̄)

that minimises the quadratic model, and Quu, whose inverse is the covariance of the maximum-entropy
policy π_G(u|x) = N(g(x), Quu⁻¹) (section 4). The state regularisation μ penalises deviations of the
next state, B'(V + μI)B, when gains are computed; the value function stays that of the true model.
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
        slope: Σ kᵀQ_u; at μ = 0 the model's cost changes so per unit of a small step, at μ > 0 only
            the full step's expected reduction is exact.
        curvature: Σ kᵀ Quu k.
        complete: false if a regularised Quu was not positive definite; the rest is then void.
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
            DivergenceError: a Quu without regularisation is no precision.
        """
        try:
            np.linalg.cholesky(self.q_uu)
            covariances = np.linalg.inv(self.q_uu)
        except np.linalg.LinAlgError:
            covariances = np.full_like(self.q_uu, np.nan)
        if not np.isfinite(covariances).all():
            raise DivergenceError(
                "Quu has no inverse that is a covariance: raise cost_scale, or give controls more "
                "weight in the cost.",
                "indefinite_quu",
            )
        return cast(Array, covariances)


def backward_pass(
    dynamics: LinearDynamics, cost: CostExpansion, regularization: float = 0.0
) -> LocalPolicy:
    """Computes the local policy of a linear-quadratic model (section 4).

    Args:
        dynamics: f_x, f_u of each step.
        cost: expansion of each step's cost; the state after the last step costs nothing.
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
    # Matrices this small are multiplied fastest in plain loops, into memory that is there already.
    va, vb = np.empty((n_x, n_x)), np.empty((n_x, n_u))
    q_xx, q_ux, q_uu = np.empty((n_x, n_x)), np.empty((n_u, n_x)), np.empty((n_u, n_u))
    q_x, q_u = np.empty(n_x), np.empty(n_u)
    bb, ba = np.empty((n_u, n_u)), np.empty((n_u, n_x))
    left, right = np.empty((n_u, n_u)), np.empty((n_u, 1 + n_x))
    for t in range(horizon - 1, -1, -1):
        a, b = f_x[t], f_u[t]
        va[:] = 0.0
        _add_product(v_xx, a, va)
        vb[:] = 0.0
        _add_product(v_xx, b, vb)
        q_xx[:] = c_xx[t]
        _add_transposed_product(a, va, q_xx)
        q_ux[:] = c_ux[t]
        _add_transposed_product(b, va, q_ux)
        q_uu[:] = c_uu[t]
        _add_transposed_product(b, vb, q_uu)
        q_x[:] = c_x[t]
        q_u[:] = c_u[t]
        for i in range(n_x):
            for j in range(n_x):
                q_x[j] += a[i, j] * v_x[i]
            for j in range(n_u):
                q_u[j] += b[i, j] * v_x[i]

        # Solve (Quu + μ BᵀB) [k K] = −[Q_u  Q_ux + μ BᵀA] by a Cholesky factorisation.
        bb[:] = 0.0
        _add_transposed_product(b, b, bb)
        ba[:] = 0.0
        _add_transposed_product(b, a, ba)
        for i in range(n_u):
            for j in range(n_u):
                left[i, j] = q_uu[i, j] + mu * bb[i, j]
            right[i, 0] = -q_u[i]
            for j in range(n_x):
                right[i, 1 + j] = -(q_ux[i, j] + mu * ba[i, j])
        if not _solve_in_place(left, right):
            return k, gains, quu, slope, curvature, False
        k_t, gain = k[t], gains[t]
        k_t[:] = right[:, 0]
        gain[:] = right[:, 1:]
        quu[t] = q_uu

        # These equal V_x = Q_x − Q_uxᵀ Quu⁻¹ Q_u and V_xx = Q_xx − Q_uxᵀ Quu⁻¹ Q_ux at μ = 0,
        # and stay the value of the policy that is really followed at μ > 0.
        v_x[:] = q_x
        for i in range(n_u):
            quu_k = 0.0
            for j in range(n_u):
                quu_k += q_uu[i, j] * k_t[j]
            slope += k_t[i] * q_u[i]
            curvature += k_t[i] * quu_k
            for j in range(n_x):
                v_x[j] += gain[i, j] * (quu_k + q_u[i]) + q_ux[i, j] * k_t[i]
        _add_transposed_product(q_ux, gain, q_xx)
        _add_product(q_uu, gain, q_ux)  # now Q_ux + Quu K
        _add_transposed_product(gain, q_ux, q_xx)
        for i in range(n_x):
            for j in range(n_x):
                v_xx[i, j] = 0.5 * (q_xx[i, j] + q_xx[j, i])
    return k, gains, quu, slope, curvature, True


@compiled
def _add_product(a, b, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds a b to out."""
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            factor = a[i, k]
            for j in range(b.shape[1]):
                out[i, j] += factor * b[k, j]


@compiled
def _add_transposed_product(a, b, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds aᵀb to out."""
    for k in range(a.shape[0]):
        for i in range(a.shape[1]):
            factor = a[k, i]
            for j in range(b.shape[1]):
                out[i, j] += factor * b[k, j]


@compiled
def _solve_in_place(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Overwrites b with a⁻¹b; false if a is not positive definite (or not a number)."""
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
