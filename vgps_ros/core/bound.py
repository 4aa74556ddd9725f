# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The variational bound L(q, θ) of section 3, which both steps of Algorithm 1 raise.

Section 3 defines log p(O|θ) = L(q, θ) + KL(q(ζ) ‖ p(ζ|O, θ)). In L, q shares p(x_1) and the
dynamics' noise with p(ζ|θ), so they cancel, and with p(O|x, u) ∝ exp(−α c) and π_G = q(u|x)

    L(q, θ) = ∫ q(ζ) log [p(O|ζ) p(ζ|θ) ÷ q(ζ)] dζ
            = −Σ_t { α E_q[c(x_t, u_t)] + E_q(x_t)[ KL(q(u_t|x_t) ‖ π_θ(u_t|x_t)) ] }   [nat],

higher is better. At a fixed α neither step lowers it: the M-step (section 5) takes the θ of least
divergence, and the q-step (Eq. 2, section 4) the q of the least of both terms together. Values at
different α are bounds on different objectives, and cannot be compared.

It is exact for linear dynamics, a quadratic cost and a linear policy. Otherwise E_q is taken over
the linearised marginals of section 4, as both steps take it: E_q[c] is that of the cost's
Gauss-Newton expansion, and the divergence is averaged over points of the marginals.
"""

import numpy as np

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.gaussians import kl_divergence
from vgps_ros.core.marginals import control_means, with_clamped_variances
from vgps_ros.core.observation import Observation, sample_inputs
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, TrajectoryDistribution


def expected_cost(q: TrajectoryDistribution, cost: TrajectoryCost) -> float:
    """Returns Σ_t E_q[c(x_t, u_t)], of the expansion of c around q's mean."""
    e, sigma = cost.expand(q.mean), q.state_covariances[:-1]
    crossed = q.gains @ sigma  # covariance of u and x, K Σ
    controls = q.control_covariances + crossed @ np.swapaxes(q.gains, 1, 2)
    spread = [(e.c_xx, sigma), (e.c_uu, controls), (2.0 * e.c_ux, crossed)]
    return float(e.c.sum() + 0.5 * sum(np.sum(h * covariance) for h, covariance in spread))


def expected_divergence(
    q: TrajectoryDistribution,
    policy: GaussianPolicy,
    observation: Observation,
    rng: np.random.Generator,
) -> float:
    """Returns Σ_t E_q(x_t)[KL(q(u_t|x_t) ‖ π_θ(u_t|x_t))], in nat.

    In a control that a limit clamps q has no noise, so only its distance from the policy counts.
    The generator turns the points over which the divergence is averaged; equal draws make the
    values of several q and θ comparable.
    """
    if observation.past:
        count = 2 * q.state_covariances.shape[1]
        deviations, inputs = sample_inputs(q, observation, count, rng)
    else:
        deviations = balanced_deviations(q, rng)
        states = observation.space.add(q.mean.states[:-1], deviations)
        inputs = observation.within(q.context)(states)
    noise = policy.noise_std**2
    covariances = with_clamped_variances(q.control_covariances, noise)
    same = np.zeros_like(q.mean.controls)
    spread = kl_divergence(same, covariances, same, np.diag(noise))
    r = control_means(q, deviations) - policy.mean(inputs)
    return float(spread.sum() + 0.5 * np.sum(r**2 / noise) / len(r))


def balanced_deviations(q: TrajectoryDistribution, rng: np.random.Generator) -> Array:
    """Returns points δx with exactly the mean and covariance of q(x_t), shape (2 n_dx, T, n_dx).

    They are ±√n_dx times the columns of a root of Σ_t that is turned at random: averages of
    functions up to the third degree are exact, as in the cubature rule of Arasaratnam and Haykin
    (2009), and the turn keeps the points where Gaussian samples lie.
    """
    roots = q.state_roots
    n = roots.shape[-1]
    turn = np.linalg.qr(rng.standard_normal((n, n))).Q
    columns = np.sqrt(n) * np.moveaxis(roots @ turn, 2, 0)
    return np.concatenate([columns, -columns])
