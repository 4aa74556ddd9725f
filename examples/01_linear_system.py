# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 from scratch, in NumPy alone, on a linear system, where all of it is exact.

A mass is pushed to rest. The policy is u = W x + noise; its trajectory's distribution is Gaussian.
Each iteration prints the bound L(q, θ), which neither step lowers, and the noise that is left.

    python examples/01_linear_system.py
"""

import numpy as np

T, dt, alpha = 50, 0.1, 1.0
A, B = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[0.0], [dt]])
Q, R = np.diag([1.0, 0.1]), np.array([[0.01]])  # c = xᵀ Q x + uᵀ R u
x_1, S_1 = np.array([1.0, 0.0]), 0.01 * np.eye(2)  # mean and covariance of the first state


def q_step(W: np.ndarray, var: float) -> tuple[np.ndarray, np.ndarray]:
    """Minimises KL(q ‖ p(ζ | O, θ)): DDP on α c − log π_θ; returns K_t and Quu_t⁻¹ (section 4)."""
    V, gains, covariances = np.zeros((2, 2)), [], []
    for _ in range(T):  # backwards in time; V is the Hessian of the value
        q_xx = 2 * alpha * Q + W.T @ W / var + A.T @ V @ A
        q_ux = -W / var + B.T @ V @ A
        q_uu = 2 * alpha * R + 1 / var + B.T @ V @ B
        K = -np.linalg.solve(q_uu, q_ux)
        V = q_xx + K.T @ q_ux
        gains.append(K)
        covariances.append(np.linalg.inv(q_uu))
    return np.array(gains[::-1]), np.array(covariances[::-1])


def marginals(gains: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Returns E[x xᵀ] at each step under q, shape (T, 2, 2)."""
    moments = [S_1 + np.outer(x_1, x_1)]
    for K, S in zip(gains[:-1], covariances[:-1], strict=True):
        moments.append((A + B @ K) @ moments[-1] @ (A + B @ K).T + B @ S @ B.T)
    return np.array(moments)


W, var = np.zeros((1, 2)), 1e4  # a policy that knows nothing
for k in range(1, 21):
    gains, covariances = q_step(W, var)  # lines 1 and 6
    moments = marginals(gains, covariances)  # line 3
    # Line 4, θ ← argmax L(q, θ): a regression of q's actions on its states, in closed form.
    W = np.linalg.solve(moments.sum(0), (moments @ gains.swapaxes(1, 2)).sum(0)).T
    miss = gains - W
    var = float((miss @ moments @ miss.swapaxes(1, 2) + covariances).mean())
    acting = gains @ moments @ gains.swapaxes(1, 2) + covariances  # E[u²] under q
    cost = float((np.trace(moments @ Q, axis1=1, axis2=2) + R[0, 0] * acting[:, 0, 0]).sum())
    log_policy = -0.5 * T * (1 + np.log(2 * np.pi * var))
    entropy = 0.5 * np.log(2 * np.pi * np.e * covariances[:, 0, 0]).sum()
    bound = -alpha * cost + log_policy + entropy
    print(f"{k:2d}: bound {bound:10.4f}, cost of q {cost:8.4f}, noise {var**0.5:7.4f} N, W {W[0]}")
