# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The M-step: maximise L(q, θ) with respect to the policy (section 5).

Up to a constant, with states drawn from the marginals of q, the objective is

    L(q, θ) = E[ −½ (μ_θ − μ_q)ᵀ Σ_θ⁻¹ (μ_θ − μ_q) − ½ log|Σ_θ| − ½ tr(Σ_θ⁻¹ Σ_q) ].

The *analytic* form uses the mean and covariance of q(u|x) as they stand. The *sampled* form
(Eq. 3) draws actions too; it is the same expression with the drawn action as mean and no
covariance. For a diagonal Σ_θ the best noise is a closed form, σ_j² = E[(μ_θ − μ_q)_j² +
(Σ_q)_jj], so it is profiled out and only the network is left to optimise:

    minimise  ½ Σ_j log E[(μ_θ − μ_q)_j² + (Σ_q)_jj].
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.marginals import control_means, sample_deviations, sample_rollout_noise
from vgps_ros.core.observation import Observation
from vgps_ros.core.optimizer_settings import FitSettings
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_network import LEAST_NOISE, Standardization, minimize_lbfgs
from vgps_ros.core.records import Array, TrajectoryDistribution


@dataclass(frozen=True)
class Targets:
    """Supervision of the fit, N samples pooled over steps and trajectories.

    Attributes:
        inputs: what the policy reads, shape (N, n_o).
        means: μ_q, or drawn actions, shape (N, n_u), [N·m].
        variances: diagonal of Σ_q, or zero for drawn actions, shape (N, n_u), [N²·m²].
    """

    inputs: Array
    means: Array
    variances: Array


def draw_targets(
    distributions: Sequence[TrajectoryDistribution],
    observation: Observation,
    form: str,
    samples_per_step: int,
    rng: np.random.Generator,
) -> Targets:
    """Draws the samples of one M-step from q(x_t), or from q(x_t, u_t) in the sampled form."""
    parts = []
    for q in distributions:
        deviations = sample_deviations(q, samples_per_step, rng)
        means = control_means(q, deviations)
        variances = np.broadcast_to(
            np.diagonal(q.control_covariances, axis1=1, axis2=2), means.shape
        )
        if form == "sampled":
            means = means + sample_rollout_noise(q, samples_per_step, rng)
            variances = np.zeros_like(means)
        states = observation.space.add(q.mean.states[:-1], deviations)
        parts.append((observation(states), means, variances))
    inputs, means, variances = (
        np.concatenate([part.reshape(-1, part.shape[-1]) for part in column])
        for column in zip(*parts, strict=True)
    )
    return Targets(inputs, means, variances)


def resampled(
    targets: Targets, probabilities: Array | None, count: int, rng: np.random.Generator
) -> Iterator[Targets]:
    """Yields draws from a set of samples, without end.

    Args:
        targets: the set of samples.
        probabilities: their probabilities, shape (N,); None if all are equal.
        count: number of samples in each draw.
        rng: source of the draws.
    """
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
) -> GaussianPolicy:
    """Returns the policy that maximises L(q, θ), started from `policy`.

    The result is never worse than `policy` on fresh samples.

    Raises:
        DivergenceError: SGD or Adam left the finite numbers.
    """

    def samples() -> Iterator[Targets]:
        while True:
            yield draw_targets(
                distributions, observation, settings.form, settings.samples_per_step, rng
            )

    scaling = Standardization.of(policy.architecture, observation, distributions)
    return fit_to_targets(policy, samples(), scaling, settings)


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

    Raises:
        DivergenceError: SGD or Adam left the finite numbers.
    """
    theta = scaling.to_standard(policy.parameters)
    if settings.optimizer == "lbfgs":  # it begins anew with new samples
        for start in range(0, settings.iterations, settings.resample_every):
            iterations = min(settings.resample_every, settings.iterations - start)
            theta = minimize_lbfgs(theta, _loss(scaling, next(samples)), iterations)
    else:
        theta = _fit_gradient(theta, scaling, samples, settings)
    parameters = scaling.to_raw(theta)
    if not np.isfinite(parameters).all():
        if settings.optimizer == "lbfgs":  # no setting would help, so the policy stays
            return with_best_noise(policy, next(samples))
        raise DivergenceError(
            f"The M-step diverged with {settings.optimizer}: lower fit.learning_rate, which is "
            f"{settings.learning_rate:g}."
        )
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


def _fit_gradient(
    start: Array, scaling: Standardization, samples: Iterator[Targets], settings: FitSettings
) -> Array:
    """SGD or Adam with new samples every iteration."""
    theta = torch.nn.Parameter(torch.from_numpy(start))
    kind = torch.optim.Adam if settings.optimizer == "adam" else torch.optim.SGD
    optimizer = kind([theta], lr=settings.learning_rate)
    for _ in range(settings.iterations):
        optimizer.zero_grad()
        _loss(scaling, next(samples))(theta).backward()
        optimizer.step()
    return np.asarray(theta.detach())


def _loss(scaling: Standardization, targets: Targets) -> Callable[[torch.Tensor], torch.Tensor]:
    """Returns the profiled objective as a function of θ in standardised units."""
    x, mu_q = scaling.inputs(targets.inputs), scaling.controls(targets.means)
    least = torch.from_numpy((LEAST_NOISE / scaling.output_scale) ** 2)
    sigma_q = torch.from_numpy((targets.variances / scaling.output_scale**2).mean(axis=0))

    def profiled(theta: torch.Tensor) -> torch.Tensor:
        squares = (scaling.network(theta, x) - mu_q) ** 2
        return 0.5 * torch.log(torch.maximum(squares.mean(dim=1) + sigma_q, least)).sum()

    return profiled
