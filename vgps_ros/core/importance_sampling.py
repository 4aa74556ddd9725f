# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The objective of guided policy search (Levine and Koltun, ICML 2013), and its maximisation.

N rollouts ζ_i, drawn from several distributions q_j, estimate the return of any policy by
normalised importance sampling of their first t steps:

    w_it(θ) = π_θ(ζ_i,1:t) / q(ζ_i,1:t),    q = Σ_j (N_j / N) q_j,    Z_t(θ) = Σ_i w_it(θ)

    Φ(θ) = Σ_t [ −1/Z_t(θ) Σ_i w_it(θ) c(x_t, u_t) + w_r log Z_t(θ) ].

The second term keeps some of the rollouts probable, which the normalised estimate alone does not.
The dynamics are the same under every distribution and cancel: only controls count.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.special import logsumexp, softmax

from vgps_ros.core.network_passes import Passes
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_network import Standardization, minimize_lbfgs
from vgps_ros.core.records import Array


@dataclass(frozen=True)
class ImportanceSamples:
    """Rollouts and the density that they were drawn with.

    Attributes:
        inputs: what the policy reads of x_1 … x_T, shape (N, T, n_o).
        controls: shape (N, T, n_u), [N·m].
        costs: c(x_t, u_t), shape (N, T).
        log_density: log q(ζ_i,1:t) without the dynamics [nat], shape (N, T).
    """

    inputs: Array
    controls: Array
    costs: Array
    log_density: Array


def mixture_log_density(log_densities: Sequence[Array], counts: Sequence[int]) -> Array:
    """Returns log q(ζ_i,1:t) [nat], shape (N, T), of a mixture.

    Args:
        log_densities: log q_j(u_t|x_t) of every rollout, each of shape (N, T).
        counts: N_j, the number of rollouts that came from each q_j.
    """
    prefixes = np.cumsum(np.stack(log_densities), axis=2)
    shares = np.asarray(counts, dtype=float)[:, None, None] / np.sum(counts)
    return np.asarray(logsumexp(prefixes, b=shares, axis=0))


def log_weights(policy: GaussianPolicy, samples: ImportanceSamples) -> Array:
    """Returns log w_it(θ) [nat], shape (N, T)."""
    densities = policy.log_density(samples.inputs, samples.controls)
    return np.cumsum(densities, axis=1) - samples.log_density


def expected_cost(policy: GaussianPolicy, samples: ImportanceSamples) -> float:
    """Returns the normalised estimate of E[Σ_t c] under the policy."""
    return float((softmax(log_weights(policy, samples), axis=0) * samples.costs).sum())


def objective(
    policy: GaussianPolicy, sets: Sequence[ImportanceSamples], regularization: float
) -> float:
    """Returns Φ(θ) for w_r = `regularization`, summed over the sets of several initial states."""
    log_z = [logsumexp(log_weights(policy, samples), axis=0).sum() for samples in sets]
    costs = [expected_cost(policy, samples) for samples in sets]
    return float(regularization * np.sum(log_z) - np.sum(costs))


def maximize(
    policy: GaussianPolicy,
    sets: Sequence[ImportanceSamples],
    regularization: float,
    scaling: Standardization,
    iterations: int,
) -> GaussianPolicy:
    """Returns the policy that LBFGS finds, started from `policy`; its Φ is never lower.

    Args:
        policy: policy from which LBFGS starts.
        sets: the rollouts of each initial state.
        regularization: w_r.
        scaling: units of the optimisation.
        iterations: iterations of LBFGS.
    """
    count = len(policy.parameters)
    theta = scaling.to_standard(policy.parameters)
    log_sigma = np.log(policy.noise_std / scaling.output_scale)
    losses = [_Loss(samples, regularization, scaling) for samples in sets]

    def value_and_gradient(point: Array) -> tuple[float, Array]:
        found = [loss.at(point[:count], point[count:]) for loss in losses]
        return sum(value for value, _ in found), np.sum([slope for _, slope in found], axis=0)

    start = np.concatenate([theta, log_sigma])
    found = minimize_lbfgs(start, value_and_gradient, iterations)
    parameters = scaling.to_raw(found[:count])
    noise_std = np.exp(found[count:]) * scaling.output_scale
    # Φ may grow without bound where the noise vanishes around a single rollout.
    if not (np.isfinite(parameters).all() and np.isfinite(noise_std).all() and noise_std.all()):
        return policy
    candidate = replace(policy, parameters=parameters, noise_std=noise_std)
    return max(policy, candidate, key=lambda p: objective(p, sets, regularization))


class _Loss:
    """−Φ ÷ T as a function of (θ, log σ), all in standardised units."""

    def __init__(self, samples: ImportanceSamples, regularization: float, scaling: Standardization):
        self._regularization, self._architecture = regularization, scaling.architecture
        self._inputs = scaling.inputs(samples.inputs)
        self._controls = scaling.controls(samples.controls)
        self._costs = torch.from_numpy(samples.costs)
        self._log_q = torch.from_numpy(samples.log_density)
        per_control = 0.5 * np.log(2 * np.pi) + np.log(scaling.output_scale)
        self._constant = float(per_control.sum())

    def at(self, theta: Array, log_sigma: Array) -> tuple[float, Array]:
        """Returns the loss, and its gradient by θ and log σ."""
        passes = Passes(self._architecture, theta, self._inputs)
        inverse = torch.exp(torch.from_numpy(-log_sigma))[:, None]
        z = (self._controls - passes.outputs).mul_(inverse)
        squares = z**2
        log_density = -0.5 * squares.sum(dim=0) - (log_sigma.sum() + self._constant)
        log_w = torch.cumsum(log_density.reshape(self._costs.shape), dim=1) - self._log_q
        p = torch.softmax(log_w, dim=0)
        estimate = (p * self._costs).sum(dim=0)
        log_z = torch.logsumexp(log_w, dim=0)
        value = (estimate - self._regularization * log_z).mean().item()
        by_log_w = p * (self._costs - estimate - self._regularization) / len(estimate)
        # The density of step t counts in the weights of all later steps.
        by_density = by_log_w.flip(1).cumsum(dim=1).flip(1).reshape(-1)
        by_theta = passes.backwards(z.mul_(inverse * by_density))
        by_log_sigma = (squares - 1.0) @ by_density
        return value, np.concatenate([by_theta, by_log_sigma.numpy()])
