# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The M-step: maximise L(q, θ) with respect to the policy (section 5).

Up to a constant, with states drawn from the marginals of q, the objective is

    L(q, θ) = E[ −½ (μ_θ − μ_q)ᵀ Σ_θ⁻¹ (μ_θ − μ_q) − ½ log|Σ_θ| − ½ tr(Σ_θ⁻¹ Σ_q) ].

Eq. 3 draws actions too, which gives the same in the mean; here the mean and covariance of q(u|x)
stand as they are. For a diagonal Σ_θ the best noise is a closed form, σ_j² = E[(μ_θ − μ_q)_j² +
(Σ_q)_jj], so it is profiled out and only the network is left to optimise:

    minimise  ½ Σ_j log E[(μ_θ − μ_q)_j² + (Σ_q)_jj].

Beyond the paper, the samples may include states that the policy itself has visited: see
`visited_states`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from vgps_ros.core.augmentation import Augmentation
from vgps_ros.core.fit_loss import FitLoss, minimize_gauss_newton
from vgps_ros.core.marginals import control_means, multiply_samples
from vgps_ros.core.observation import Observation, sample_inputs
from vgps_ros.core.optimizer_settings import FitSettings
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_network import LEAST_NOISE, Standardization, minimize_lbfgs
from vgps_ros.core.records import Array, TrajectoryDistribution

_LEAST_GAIN = 1e-5  # on new samples that is worth another step of Gauss and Newton [nat]
_RESAMPLE_EVERY = 25  # LBFGS iterations between new samples, 20 to 50 in the paper


@dataclass(frozen=True)
class Targets:
    """Supervision of the fit, N samples pooled over steps and trajectories.

    Attributes:
        inputs: what the policy reads, shape (N, n_o).
        means: μ_q, or actions that were drawn, shape (N, n_u), [N·m].
        variances: diagonal of Σ_q, or zero for such actions, shape (N, n_u), [N²·m²].
    """

    inputs: Array
    means: Array
    variances: Array


def draw_targets(
    distributions: Sequence[TrajectoryDistribution],
    observation: Observation,
    samples_per_step: int,
    rng: np.random.Generator,
    late: float = 0.0,
) -> Targets:
    """Draws the samples of one M-step from q(x_t).

    A share `late` of the samples reads the state one step too late.
    """
    parts = []
    for q in distributions:
        deviations, inputs = sample_inputs(q, observation, samples_per_step, rng)
        means = control_means(q, deviations)
        variances = np.broadcast_to(
            np.diagonal(q.control_covariances, axis1=1, axis2=2), means.shape
        )
        if late:
            inputs, means = _late(q, observation, deviations, inputs, means, late, rng)
        pooled = (a.reshape(-1, a.shape[-1]) for a in (inputs, means, variances))
        parts.append(Targets(*pooled))
    return _join_targets(parts)


def _late(
    q: TrajectoryDistribution,
    observation: Observation,
    deviations: Array,
    inputs: Array,
    means: Array,
    share: float,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Returns inputs (S, T, n_o) and means (S, T, n_u), of which a share is late.

    Such a sample reads h(x_t) where x_{t+1} has come already: its control is that of x_{t+1}, to
    which the linear dynamics and q's gains lead, δx_{t+1} = (f_x + f_u K) δx_t. What it is told is
    of t + 1, since commands and clock are no readings. Its last action is that of t.
    """
    f = q.linear_dynamics
    after = multiply_samples(f.f_x, deviations) + multiply_samples(f.f_u, means - q.mean.controls)
    next_means = q.mean.controls[1:] + multiply_samples(q.gains[1:], after[:, :-1])
    read = inputs[:, :-1].copy()
    if observation.told:
        told = len(observation.told)
        read[..., -told:] = inputs[:, 1:, -told:]
    if observation.past and (acted := len(observation.past.actions)):
        last = read.shape[2] - len(observation.told)
        read[..., last - acted : last] = np.clip(means[:, :-1], *observation.past.limits)
    is_late = rng.uniform(size=read.shape[:2])[..., None] < share
    inputs, means = inputs.copy(), means.copy()
    inputs[:, :-1] = np.where(is_late, read, inputs[:, :-1])
    means[:, :-1] = np.where(is_late, next_means, means[:, :-1])
    return inputs, means


def _join_targets(parts: Sequence[Targets]) -> Targets:
    """Returns the samples of several parts together."""
    columns = ((part.inputs, part.means, part.variances) for part in parts)
    return Targets(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def resample(
    targets: Targets, probabilities: Array | None, count: int, rng: np.random.Generator
) -> Iterator[Targets]:
    """Yields draws of `count` samples from a set, with probabilities or evenly, without end."""
    while True:
        chosen = rng.choice(len(targets.inputs), count, p=probabilities)
        yield Targets(targets.inputs[chosen], targets.means[chosen], targets.variances[chosen])


def objective(policy: GaussianPolicy, targets: Targets) -> float:
    """Returns L(q, θ) ÷ (M T) [nat], with the constant −½ n_u log 2π included."""
    squares = (policy.mean(targets.inputs) - targets.means) ** 2 + targets.variances
    log_sigma = np.log(policy.noise_std).sum()
    constant = 0.5 * len(policy.noise_std) * np.log(2 * np.pi)
    return float(-0.5 * (squares / policy.noise_std**2).sum(1).mean() - log_sigma - constant)


def initial_policy(scaling: Standardization, rng: np.random.Generator) -> GaussianPolicy:
    """Draws a network whose units are spread over the inputs that the scaling suits."""
    architecture = scaling.architecture
    parameters = np.zeros(architecture.num_parameters)
    for weight, bias in architecture.unpack(parameters):
        weight[:] = rng.standard_normal(weight.shape) / np.sqrt(weight.shape[1])
        if not np.isscalar(bias):
            bias[:] = rng.standard_normal(bias.shape)
    return GaussianPolicy(architecture, scaling.to_raw(parameters), scaling.output_scale)


def fit_policy(
    policy: GaussianPolicy,
    observation: Observation,
    distributions: Sequence[TrajectoryDistribution],
    settings: FitSettings,
    rng: np.random.Generator,
    visited: Sequence[Targets] = (),
    augmentation: Augmentation | None = None,
    replay: Sequence[Targets] = (),
    limits: tuple[Array, Array] | None = None,
) -> GaussianPolicy:
    """Returns the policy that maximises L(q, θ), started from `policy`.

    The result is never worse than `policy` on fresh samples.

    Args:
        policy: policy from which the fit starts.
        observation: what the policy reads.
        distributions: q of each situation, from whose marginals samples are drawn.
        settings: settings of the fit.
        rng: source of the samples.
        visited: further samples, of the states that the policy itself has visited.
        augmentation: what becomes of the samples; None: they stay as they are.
        replay: samples of earlier q, of which each iteration draws its share.
        limits: the lowest and highest controls that are taught, shape (n_u,) each; a feedback that
            asks for more is taught as them.
    """
    pool = _join_targets(replay) if replay else None

    def samples() -> Iterator[Targets]:
        while True:
            count, late = settings.samples_per_step, settings.late
            drawn = draw_targets(distributions, observation, count, rng, late)
            replayed = [_share(pool, settings.replayed, rng)] if pool else []
            found = _join_targets([drawn, *visited, *replayed])
            if limits:
                found = replace(found, means=np.clip(found.means, *limits))
            if augmentation:
                samples = found.inputs, found.means, found.variances
                found = Targets(*augmentation(samples, rng))
            yield found

    scaling = Standardization.of(policy.architecture, observation, distributions)
    return fit_to_targets(policy, samples(), scaling, settings)


def _share(pool: Targets, share: float, rng: np.random.Generator) -> Targets:
    """Draws a share of the samples, without putting any back."""
    if share == 1.0:
        return pool
    rows = rng.choice(len(pool.inputs), math.ceil(share * len(pool.inputs)), replace=False)
    return Targets(pool.inputs[rows], pool.means[rows], pool.variances[rows])


def fit_to_targets(
    policy: GaussianPolicy,
    samples: Iterator[Targets],
    scaling: Standardization,
    settings: FitSettings,
) -> GaussianPolicy:
    """Returns the policy that maximises L(q, θ), started from `policy`.

    Args:
        policy: policy from which the fit starts.
        samples: endless; the fit takes the next ones whenever it draws samples anew.
        scaling: units of the fit.
        settings: settings of the fit.
    """
    theta = scaling.to_standard(policy.parameters)
    losses = (fit_loss(scaling, targets) for targets in samples)
    if settings.optimizer == "gauss_newton":
        iterations, retries = settings.iterations, settings.retries
        theta = minimize_gauss_newton(theta, losses, iterations, _LEAST_GAIN, retries)
    else:
        theta = _fit_lbfgs(theta, losses, settings)
    parameters = scaling.to_raw(theta)
    if not np.isfinite(parameters).all():
        return with_best_noise(policy, next(samples))  # no setting would help
    targets = next(samples)
    candidates = [
        with_best_noise(candidate, targets)
        for candidate in (policy, replace(policy, parameters=parameters))
    ]
    return max(candidates, key=lambda candidate: objective(candidate, targets))


def with_best_noise(policy: GaussianPolicy, targets: Targets) -> GaussianPolicy:
    """Returns the policy with the σ that maximises L(q, θ) for its network, or LEAST_NOISE."""
    squares = (policy.mean(targets.inputs) - targets.means) ** 2 + targets.variances
    return replace(policy, noise_std=np.maximum(np.sqrt(squares.mean(axis=0)), LEAST_NOISE))


def _fit_lbfgs(theta: Array, losses: Iterator[FitLoss], settings: FitSettings) -> Array:
    """LBFGS, which begins anew with new samples."""
    for start in range(0, settings.iterations, _RESAMPLE_EVERY):
        iterations = min(_RESAMPLE_EVERY, settings.iterations - start)
        theta = minimize_lbfgs(theta, next(losses).value_and_gradient, iterations)
    return theta


def fit_loss(scaling: Standardization, targets: Targets) -> FitLoss:
    """Returns the profiled objective as a function of θ in standardised units."""
    variances = (targets.variances / scaling.output_scale**2).mean(axis=0)
    return FitLoss(
        scaling.architecture,
        scaling.inputs(targets.inputs),
        scaling.controls(targets.means),
        torch.from_numpy(variances),
        torch.from_numpy((LEAST_NOISE / scaling.output_scale) ** 2),
    )
