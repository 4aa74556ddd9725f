# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The marginals of the Gaussian trajectory distribution q(ζ) (section 4).

In deviations from the trajectory, δx = x ⊖ x̄ and δu = u − ū:

    δu = K δx + noise of covariance Quu⁻¹,    δx' = f_x δx + f_u δu + ε,  ε ~ N(0, Σ_f).

q is centred on the trajectory that was executed last, whose k is zero once DDP has converged; the
means of δx and δu are then zero, and the covariances are all that is left to compute. Before that,
k would shift the means by a full step that no line search has tried (docs/explanation/method.md).
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from vgps_ros.core.checks import LARGEST_ROUNDING
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.gaussians import covariance_roots, log_density
from vgps_ros.core.records import Array, LinearDynamics, TrajectoryDistribution
from vgps_ros.core.settings import Range

# A linearisation means nothing for states spread beyond it [m, rad, m/s, rad/s].
STD_BOUND = 1e6
# Where a coordinate is exact, or follows from the others, an inverse needs some spread.
_LEAST_STD, _LEAST_CORRELATION = 1e-9, 1e-6
_LEAST_SHARE = 1e-9  # of a variance, that is more than rounding


@dataclass(frozen=True)
class Spread:
    """The sources and the limit of the states' spread.

    Attributes:
        initial_std: standard deviation of x_1, shape (n_dx,).
        dynamics_std: standard deviation of ε, the square roots of Σ_f's diagonal, shape (n_dx,), or
            (T, n_dx) where it changes with time.
        std_limit: largest standard deviation of each coordinate, shape (n_dx,); inf for none. It
            keeps linearised covariances inside the region where they mean something, and the
            policy's fit to states near the trajectory.
    """

    initial_std: Array
    dynamics_std: Array
    std_limit: Array


@dataclass(frozen=True)
class MarginalSettings:
    """Settings of the marginals' width: from so far away the policy learns to come back."""

    initial_std_factor: Annotated[
        float, Range(0.0, 100.0), "factor on the standard deviation of x_1 that the task names"
    ] = 1.0
    velocity_noise: Annotated[
        float,
        Range(0.0, 10.0),
        "standard deviation of the noise Sigma_f that each step adds to each velocity [m/s, rad/s]",
    ] = 0.0
    std_limit_annealing: Annotated[
        float,
        Range(0.0, 10.0),
        "exponent p of the task's limits on the standard deviations, times alpha^p: with p > 0 "
        "the region that the policy is fitted in shrinks as alpha falls",
    ] = 0.0

    def spread(
        self, initial_std: Array, std_limit: Array, velocities: slice, alpha: float
    ) -> Spread:
        """Returns the spread at α.

        Args:
            initial_std: the task's, shape (n_dx,).
            std_limit: the task's, at α = 1, shape (n_dx,).
            velocities: where the velocities stand in a deviation.
            alpha: α, the cost's scale.
        """
        noise = np.zeros_like(initial_std)
        noise[velocities] = self.velocity_noise
        return Spread(
            self.initial_std_factor * initial_std,
            noise,
            alpha**self.std_limit_annealing * std_limit,
        )


def state_covariances(
    linear: LinearDynamics, gains: Array, control_covariances: Array, spread: Spread
) -> Array:
    """Returns Σ_1 … Σ_{T+1}, shape (T+1, n_dx, n_dx), by the recursion of section 4.

    Raises:
        DivergenceError: a standard deviation passes STD_BOUND, or rounding has the upper hand.
    """
    from vgps_ros.core.compiled_gaussians import propagate

    horizon, n_dx, _ = linear.f_x.shape
    closed_loop = linear.f_x + linear.f_u @ gains
    noise = linear.f_u @ control_covariances @ np.swapaxes(linear.f_u, 1, 2)
    noise[:, np.arange(n_dx), np.arange(n_dx)] += spread.dynamics_std**2
    sigma = np.empty((horizon + 1, n_dx, n_dx))
    propagate(np.diag(spread.initial_std**2), closed_loop, noise, spread.std_limit, sigma)
    # Written so that a NaN raises the error too.
    exploded = ~(np.diagonal(sigma, axis1=1, axis2=2).max(axis=1) <= STD_BOUND**2)
    if exploded.any():
        raise DivergenceError(
            f"The marginals explode: at step {exploded.argmax()} of {horizon} a coordinate's "
            f"standard deviation passes {STD_BOUND:g}. Raise alpha (cost_scale), give the task a "
            "std_limit, or shorten its horizon.",
            "exploding_marginals",
        )
    _check_rounding(sigma, gains)
    return sigma


def sample_deviations(
    distribution: TrajectoryDistribution, count: int, rng: np.random.Generator
) -> Array:
    """Draws δx from the marginals q(x_t), t = 1 … T; returns shape (count, T, n_dx).

    Samples come in pairs ±δ: for an even count their mean is exactly zero, so that averages over
    them carry no noise of first order.
    """
    return _in_pairs(distribution.state_roots, count, rng)


def sample_joint_deviations(
    distribution: TrajectoryDistribution, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draws (δx, δu) from q(x_t, u_t), in such pairs; returns (count, T, n_dx), (count, T, n_u)."""
    deviations = sample_deviations(distribution, count, rng)
    noise = _in_pairs(covariance_roots(distribution.control_covariances), count, rng)
    return deviations, multiply_samples(distribution.gains, deviations) + noise


@dataclass(frozen=True)
class Histories:
    """Deviations of former steps, drawn jointly with those of q(x_t).

    Attributes:
        states: δx_t, δx_{t−1} … δx_{t−L}, shape (L+1, count, T, n_dx). Before x_1 all are δx_1.
        controls: δu_{t−1}, with π_G's noise, shape (count, T, n_u); of no meaning at t = 1.
    """

    states: Array
    controls: Array


def sample_histories(
    distribution: TrajectoryDistribution, count: int, length: int, rng: np.random.Generator
) -> Histories:
    """Draws (δx_{t−L}, …, δx_t) from q for each t = 1 … T, in pairs ± as `sample_deviations` does.

    A motion of L steps begins in the marginal of x_{t−L}, and follows q's linear dynamics and
    gains, with the noise of the dynamics. Where a limit has narrowed a marginal on the way, the
    motion is narrowed alike.
    """
    q, f = distribution, distribution.linear_dynamics
    horizon, roots = q.mean.horizon, covariance_roots(distribution.control_covariances)
    narrowing, dynamics_std = _narrowing(q)
    steps = np.arange(q.mean.horizon)
    start = np.maximum(steps - length, 0)
    found = [_in_pairs(q.state_roots[start], count, rng)]
    controls = np.zeros((count, horizon, f.f_u.shape[2]))
    for lag in range(length, 0, -1):
        i = np.maximum(steps - lag, 0)
        acted = multiply_samples(q.gains[i], found[-1]) + _in_pairs(roots[i], count, rng)
        after = multiply_samples(f.f_x[i], found[-1]) + multiply_samples(f.f_u[i], acted)
        if dynamics_std.any():
            after += _in_pairs(dynamics_std[i][:, :, None] * np.eye(after.shape[2]), count, rng)
        moves = (steps >= lag)[:, None]
        controls = np.where(moves, acted, controls)
        scale = np.where(moves, narrowing[i], 1.0)
        found = [scale * each for each in (*found, np.where(moves, after, found[-1]))]
    return Histories(np.stack(found[::-1]), controls)


def recollections(distribution: TrajectoryDistribution, length: int) -> tuple[Array, Array]:
    """Returns what a state tells of former steps under q, to first order.

    Returns:
        G with E[δx_{t−l} | δx_t] = G δx_t for l = 1 … L, shape (L, T, n_dx, n_dx), and the same of
        δu_{t−1}, shape (T, n_u, n_dx); the latter is zero at t = 1.
    """
    q, f = distribution, distribution.linear_dynamics
    steps, (narrowing, _) = np.arange(q.mean.horizon), _narrowing(q)
    sigma, closed = q.state_covariances, f.f_x + f.f_u @ q.gains
    std = np.maximum(np.sqrt(np.diagonal(sigma[:-1], axis1=1, axis2=2)), _LEAST_STD)
    correlations = sigma[:-1] / (std[:, :, None] * std[:, None])
    widened = correlations + _LEAST_CORRELATION * np.eye(std.shape[1])

    def regression_gains(crossed: Array) -> Array:
        """Returns C Σ_t⁻¹ for covariances with x_t, shape (T, m, n_dx)."""
        scaled = np.swapaxes(crossed / std[:, None], 1, 2)
        return np.asarray(np.swapaxes(np.linalg.solve(widened, scaled), 1, 2) / std[:, None])

    found = []
    for ago in range(1, length + 1):
        crossed = sigma[np.maximum(steps - ago, 0)]
        for lag in range(ago, 0, -1):
            i = np.maximum(steps - lag, 0)
            after = crossed @ np.swapaxes(closed[i], 1, 2)
            after *= narrowing[i][:, :, None] * narrowing[i][:, None]
            crossed = np.where((steps >= lag)[:, None, None], after, crossed)
        found.append(regression_gains(crossed))
    i = np.maximum(steps - 1, 0)
    crossed = q.gains[i] @ sigma[i] @ np.swapaxes(closed[i], 1, 2)
    crossed += q.control_covariances[i] @ np.swapaxes(f.f_u[i], 1, 2)
    acted = regression_gains(crossed * narrowing[i][:, None])
    acted[0] = 0.0
    return np.stack(found), acted


def _narrowing(q: TrajectoryDistribution) -> tuple[Array, Array]:
    """Returns how each coordinate's spread after steps 1 … T differs from that of law and noise.

    Returns:
        The factor by which a limit has narrowed it, shape (T, n_dx), and where it is wider the
        standard deviation that the dynamics' noise Σ_f has added, of the same shape.
    """
    f, sigma = q.linear_dynamics, q.state_covariances
    closed = f.f_x + f.f_u @ q.gains
    after = closed @ sigma[:-1] @ np.swapaxes(closed, 1, 2)
    after += f.f_u @ q.control_covariances @ np.swapaxes(f.f_u, 1, 2)
    squares = [np.diagonal(each, axis1=1, axis2=2) for each in (sigma[1:], after)]
    ratio = squares[0] / np.maximum(squares[1], _LEAST_STD**2)
    added = squares[0] - squares[1]
    added[added <= _LEAST_SHARE * squares[0]] = 0.0  # which is rounding
    return np.sqrt(np.minimum(ratio, 1.0)), np.sqrt(added)


def sample_rollout_noise(
    distribution: TrajectoryDistribution, count: int, rng: np.random.Generator
) -> Array:
    """Draws π_G's control noise, N(0, Quu⁻¹); returns shape (count, T, n_u), [N·m]."""
    roots = covariance_roots(distribution.control_covariances)
    noise = rng.standard_normal((count, *roots.shape[:2]))
    return multiply_samples(roots, noise)


def control_means(distribution: TrajectoryDistribution, deviations: Array) -> Array:
    """Returns the mean of q(u_t|x_t), ū + K δx, for deviations of shape (S, T, n_dx)."""
    return distribution.mean.controls + multiply_samples(distribution.gains, deviations)


def with_clamped_variances(covariances: Array, variances: Array | float) -> Array:
    """Returns covariances (T, n_u, n_u) with variances (n_u,) for the controls that have none.

    Those are the controls that a limit clamps. A density, or a divergence from one, needs some.
    """
    is_clamped = np.diagonal(covariances, axis1=1, axis2=2) == 0.0
    added = is_clamped[:, :, None] * (variances * np.eye(covariances.shape[1]))
    return np.asarray(covariances + added)


def control_log_density(
    distribution: TrajectoryDistribution, deviations: Array, controls: Array
) -> Array:
    """Returns log q(u_t|x_t) [nat], shape (S, T), of controls (S, T, n_u).

    The states are given as deviations from the mean, shape (S, T, n_dx). No control may be without
    noise (see `with_clamped_variances`).
    """
    means = control_means(distribution, deviations)
    return log_density(controls - means, distribution.control_covariances)


def multiply_samples(matrices: Array, vectors: Array) -> Array:
    """Returns M_t v_st, shape (S, T, m), for matrices (T, m, n) and vectors (S, T, n)."""
    return np.ascontiguousarray(np.moveaxis(matrices @ np.moveaxis(vectors, 0, 2), 2, 0))


def _in_pairs(roots: Array, count: int, rng: np.random.Generator) -> Array:
    """Draws ±R noise for roots (T, n, n), shape (count, T, n)."""
    noise = rng.standard_normal(((count + 1) // 2, *roots.shape[:2]))
    deviations = multiply_samples(roots, noise)
    return np.concatenate([deviations, -deviations])[:count]


def _check_rounding(sigma: Array, gains: Array) -> None:
    """Checks that enormous gains, which cancel enormous derivatives, leave some digits."""
    skew = np.abs(sigma - sigma.transpose(0, 2, 1)).max(axis=(1, 2))
    lost = skew > LARGEST_ROUNDING * np.abs(sigma).max(axis=(1, 2))
    if lost.any():
        step = int(np.argmax(lost))
        raise DivergenceError(
            f"The marginals are lost in rounding at step {step} of {len(gains)}: the gains reach "
            f"{np.abs(gains[:step]).max():.0e} there, since a derivative jumps, as at a joint's "
            'limit or in contact. Let forces begin softly (changes: {joints: {"*": {solref_limit: '
            "[0.04, 1], solimp_limit: [0, 0.95, 0.1, 0.5, 2]}}}, and geoms likewise), or raise "
            "ddp.regularization_floor.",
            "exploding_marginals",
        )
