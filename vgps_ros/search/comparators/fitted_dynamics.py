# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Time-varying linear dynamics, fitted to a few rollouts (Levine and Abbeel, NIPS 2014, section 4).

In deviations from the mean x̄, ū of N rollouts, each step t has a fit of its own,

    δx_{t+1} = f_x δx_t + f_u δu_t + N(0, F),

by conditioning a Gaussian over z = (δx_t, δu_t, δx_{t+1}) on its first part. N is smaller than the
number of coordinates, so that this Gaussian has a normal-inverse-Wishart prior of mean μ_0 and
covariance Φ, and its covariance is, with m = n_0 = 1 and the empirical μ̂, Σ̂,

    Σ = [ Φ n_0 + N Σ̂ + N m / (N + m) (μ̂ − μ_0)(μ̂ − μ_0)ᵀ ] ÷ (N + n_0).

μ_0 and Φ are those of a mixture of Gaussians over (x, u, x') of all steps and of earlier rollouts:
its components, weighted by how probable they make the points of step t. So what is alike in many
steps is learned from all of them, and what the N points tell of a step itself wins as N grows.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.records import Array, LinearDynamics, Trajectory

_LEAST_SHARE = 1e-6  # of a coordinate's variance that each component has in each direction
_EM_ITERATIONS = 10
_POINTS_PER_COMPONENT = 40


@dataclass(frozen=True)
class Mixture:
    """A mixture of K Gaussians over points of n coordinates.

    Attributes:
        log_weights: shape (K,).
        means: shape (K, n).
        covariances: shape (K, n, n).
    """

    log_weights: Array
    means: Array
    covariances: Array

    @classmethod
    def fitted(cls, points: Array, most: int, rng: np.random.Generator) -> "Mixture":
        """Returns a mixture of at most so many components, by expectation maximisation.

        Args:
            points: shape (M, n).
            most: number of components where there are points enough.
            rng: draws the components' first points.
        """
        count = max(1, min(most, len(points) // _POINTS_PER_COMPONENT))
        floor = np.diag(_LEAST_SHARE * points.var(axis=0) + 1e-12)
        scale = np.sqrt(np.diag(floor))
        centres = points[rng.choice(len(points), count, replace=False)]
        squares = [np.sum(((points - c) / scale) ** 2, axis=1) for c in centres]
        shares = np.eye(count)[np.argmin(squares, axis=0)]
        for _ in range(_EM_ITERATIONS):
            found = cls._maximum(points, shares, floor)
            shares = found.shares(points)
        return found

    @classmethod
    def _maximum(cls, points: Array, shares: Array, floor: Array) -> "Mixture":
        """Returns the mixture of greatest likelihood for given shares (M, K)."""
        totals = shares.sum(axis=0) + 1e-9
        means = shares.T @ points / totals[:, None]
        covariances = []
        for k, mean in enumerate(means):
            away = points - mean
            covariances.append((shares[:, k, None] * away).T @ away / totals[k] + floor)
        return cls(np.log(totals / totals.sum()), means, np.array(covariances))

    def shares(self, points: Array) -> Array:
        """Returns how probable each component is for points (..., n), shape (..., K)."""
        roots = np.linalg.inv(np.linalg.cholesky(self.covariances))  # R with RᵀR = Σ⁻¹
        halves = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
        each = [
            weight + half - 0.5 * np.sum(((points - mean) @ root.T) ** 2, axis=-1)
            for weight, half, mean, root in zip(
                self.log_weights, halves, self.means, roots, strict=True
            )
        ]
        log_shares = np.stack(each, axis=-1)
        return np.asarray(np.exp(log_shares - logsumexp(log_shares, axis=-1, keepdims=True)))

    def moments(self, shares: Array) -> tuple[Array, Array]:
        """Returns means (T, n) and covariances (T, n, n) for shares of components (T, K)."""
        means = shares @ self.means
        second = self.covariances + self.means[:, :, None] * self.means[:, None, :]
        whole = np.einsum("tk,kij->tij", shares, second)
        return means, whole - means[:, :, None] * means[:, None, :]


def transitions(space: StateSpace, origin: Array, states: Array, controls: Array) -> Array:
    """Returns (x ⊖ x_0, u, x' ⊖ x_0) of each transition, shape (N, T, n).

    Args:
        space: of the states.
        origin: x_0, shape (n_x,).
        states: shape (N, T+1, n_x).
        controls: shape (N, T, n_u).
    """
    x = space.subtract(states, origin)
    return np.concatenate([x[:, :-1], controls, x[:, 1:]], axis=2)


def mean_trajectory(space: StateSpace, states: Array, controls: Array) -> Trajectory:
    """Returns the mean of rollouts, states (N, T+1, n_x) and controls (N, T, n_u)."""
    first = states[0]
    mean = space.add(first, space.subtract(states, first).mean(axis=0))
    return Trajectory(mean, controls.mean(axis=0))


def fitted_dynamics(
    space: StateSpace, states: Array, controls: Array, prior: Mixture, origin: Array
) -> tuple[LinearDynamics, Array]:
    """Returns f_x, f_u around the rollouts' mean, and the standard deviations of F, (T, n_dx).

    Args:
        space: of the states.
        states: of N rollouts, shape (N, T+1, n_x).
        controls: shape (N, T, n_u).
        prior: mixture over `transitions` from the same origin.
        origin: x_0, shape (n_x,).
    """
    mean = mean_trajectory(space, states, controls)
    count, horizon, n_u = controls.shape
    n_dx = space.tangent_dim
    x = space.subtract(states, mean.states)
    z = np.concatenate([x[:, :-1], controls - mean.controls, x[:, 1:]], axis=2)
    centred = z - z.mean(axis=0)
    empirical = np.einsum("nti,ntj->tij", centred, centred)  # N Σ̂
    points = transitions(space, origin, states, controls)
    mu_0, phi = prior.moments(prior.shares(points).mean(axis=0))
    # The prior counts from x_0, deviations count from x̄: turned alike where bodies turn.
    turns = space.turns(space.subtract(mean.states, origin))
    carry = np.tile(np.eye(z.shape[2]), (horizon, 1, 1))
    carry[:, :n_dx, :n_dx], carry[:, -n_dx:, -n_dx:] = turns[:-1], turns[1:]
    apart = np.einsum("tij,tj->ti", carry, points.mean(axis=0) - mu_0)
    phi = carry @ phi @ np.swapaxes(carry, 1, 2)
    sigma = phi + empirical + count / (count + 1) * apart[:, :, None] * apart[:, None, :]
    sigma /= count + 1
    known, following = slice(0, n_dx + n_u), slice(n_dx + n_u, None)
    # What no point tells of stays as it was, x' = x, by a floor under the known part.
    still = np.eye(n_dx, n_dx + n_u)
    within = sigma[:, known, known]
    crossed = sigma[:, following, known]
    least = _LEAST_SHARE * np.einsum("tii->ti", within) + 1e-12
    floor = least[:, :, None] * np.eye(n_dx + n_u)
    rest = np.swapaxes(crossed - still @ within, 1, 2)
    f = still + np.swapaxes(np.linalg.solve(within + floor, rest), 1, 2)
    # The diagonal of F = Σ_x'x' − f Σ_zx' − Σ_x'z fᵀ + f Σ_zz fᵀ.
    variances = np.einsum("tii->ti", sigma[:, following, following])
    variances = variances + np.sum(f * (f @ within - 2.0 * crossed), axis=2)
    noise = np.sqrt(np.maximum(variances, 0.0))
    return LinearDynamics(f[:, :, :n_dx], f[:, :, n_dx:]), noise
