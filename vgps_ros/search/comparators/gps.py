# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Guided policy search (Levine and Koltun, ICML 2013), as section 6 compares with it.

    θ ← argmax Σ_t [ −1/Z_t(θ) Σ_i w_it(θ) c(x_t, u_t) + w_r log Z_t(θ) ]

over N rollouts ζ_i, drawn from several distributions q_j, whose first t steps have the weights

    w_it(θ) = π_θ(ζ_i,1:t) / q(ζ_i,1:t),    q = Σ_j (N_j / N) q_j,    Z_t(θ) = Σ_i w_it(θ).

The second term keeps some of the rollouts probable, which the normalised estimate alone does not.
The dynamics are the same under every distribution and cancel: only controls count. "The GPS
algorithm first draws a fixed number of samples from the DDP solution, and then adds on-policy
samples at each iteration."

Choices where the papers leave something open: guiding rollouts are drawn with less noise than π_G,
whose broad noise at α = 1 no policy needs to reproduce. All of them and the rollouts of the latest
policies are kept. Φ is maximised from the best policy so far, judged by the mean cost of its own
rollouts. If the new policy becomes the best one, w_r falls by a factor of ten; otherwise it rises.
With `redraw` the best policy is rolled out anew beside each new one, from the same starts and with
the same noise, so that none stays the best by luck; that takes twice as many rollouts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.special import logsumexp, softmax

from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.marginals import (
    control_log_density,
    sample_rollout_noise,
    with_clamped_variances,
)
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_network import LEAST_NOISE, Passes, Standardization, minimize_lbfgs
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.rollouts import Rollouts
from vgps_ros.search.trajectory_optimization import OptimizationResult
from vgps_ros.search.workspace import Update, Workspace

_GUIDING_SAMPLES = 40  # rollouts of the DDP solution in each situation
_RECENT = 4  # latest policies, and latest adapted DDP solutions, whose rollouts are kept too
# w_r, the weight of log Z: at first, and the least and the largest that it falls and rises to.
_FIRST, _LEAST, _MOST = 1e-2, 1e-6, 1e2
_STEP = 10.0  # factor by which w_r changes


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


def estimated_cost(policy: GaussianPolicy, samples: ImportanceSamples) -> float:
    """Returns the normalised estimate of E[Σ_t c] under the policy."""
    return float((softmax(log_weights(policy, samples), axis=0) * samples.costs).sum())


def guided_objective(
    policy: GaussianPolicy, sets: Sequence[ImportanceSamples], regularization: float
) -> float:
    """Returns Φ(θ) for w_r = `regularization`, summed over the sets of several initial states."""
    log_z = [logsumexp(log_weights(policy, samples), axis=0).sum() for samples in sets]
    costs = [estimated_cost(policy, samples) for samples in sets]
    return float(regularization * np.sum(log_z) - np.sum(costs))


def maximize(
    policy: GaussianPolicy,
    sets: Sequence[ImportanceSamples],
    regularization: float,
    scaling: Standardization,
    iterations: int,
) -> GaussianPolicy:
    """Returns the policy that LBFGS finds, started from `policy`; its Φ is never lower.

    There is a set of rollouts for each initial state, and the regularization is w_r.
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
    return max(policy, candidate, key=lambda p: guided_objective(p, sets, regularization))


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


@dataclass(frozen=True)
class _Batch:
    """Rollouts of one distribution."""

    rollouts: Rollouts  # the rollouts that did not diverge
    source: GaussianPolicy | TrajectoryDistribution  # the distribution that they were drawn from

    def log_density(self, observation: Observation, states: Array, controls: Array) -> Array:
        """Returns log q(u_t|x_t) of states (N, T, n_x) and controls (N, T, n_u), shape (N, T)."""
        q = self.source
        if isinstance(q, GaussianPolicy):
            return q.log_density(observation(states), controls)
        deviations = observation.space.subtract(states, q.mean.states[:-1])
        return control_log_density(q, deviations, controls)


Batches = tuple[tuple[_Batch, ...], ...]
"""The batches from each initial state."""


@dataclass(frozen=True)
class GuidedUpdate(Update):
    """The result of one iteration; its policy is the best one so far.

    Attributes:
        lowest: mean cost of this policy's rollouts; inf if one diverged.
        regularization: w_r.
        guiding: rollouts of the initial solutions, one batch from each initial state.
        recent: rollouts of the latest policies.
        adapted: rollouts of the latest adapted solutions.
    """

    lowest: float
    regularization: float
    guiding: Batches
    recent: Batches
    adapted: Batches


def guided_search(
    work: Workspace, last: GuidedUpdate | None, k: int, *, adapts: bool
) -> GuidedUpdate:
    """Does iteration k of guided policy search, or of its variant that adapts q(ζ) as vgps does.

    That one "runs DDP at every iteration and adapts to the current policy, in the same manner as
    our method. However, samples from this adapted DDP solution are then included in the policy
    optimization with importance sampling". They are kept as long as those of the policies.

    Raises:
        DivergenceError: all rollouts from an initial state diverged.
    """
    settings, scaling = work.settings.gps, work.standardization()
    if last is None:
        last = _first(work)
        latest = last.policy
    else:
        kept = list(zip(last.guiding, last.adapted, last.recent, strict=True))
        samples = [
            combine_rollouts([*guiding, *adapted, *recent], here.observation)
            for here, (guiding, adapted, recent) in zip(work.tasks, kept, strict=True)
        ]
        latest = maximize(
            last.policy, samples, last.regularization, scaling, work.settings.fit.iterations
        )
    recent, lowest = last.recent, last.lowest
    if settings.redraw and k > 1:
        recent, lowest = _with_rollouts(work, recent, last.policy, k)
    recent, cost = _with_rollouts(work, recent, latest, k)
    improves = cost < lowest
    w_r = last.regularization
    if k > 1:
        w_r *= 1.0 / _STEP if improves else _STEP
        w_r = max(_LEAST, min(w_r, _MOST))
    best, lowest = (latest, cost) if improves else (last.policy, lowest)
    solutions, adapted = last.solutions, last.adapted
    if adapts:
        solutions = work.reoptimize(solutions, best, k)
        guides = _guiding_distributions(work, solutions)
        new = [_guide(work, q, i, work.settings.policy_rollouts, k) for i, q in enumerate(guides)]
        adapted = _latest_batches(adapted, new, _RECENT)
    return GuidedUpdate(best, solutions, lowest, w_r, last.guiding, recent, adapted)


def _with_rollouts(
    work: Workspace, recent: Batches, policy: GaussianPolicy, k: int
) -> tuple[Batches, float]:
    """Rolls a policy out; returns the batches that are kept then, and the rollouts' mean cost."""
    draws = work.sample_policy(policy, work.settings.policy_rollouts, k)
    new = [_Batch(rollouts.sound(), policy) for rollouts in draws]
    kept = _RECENT * (2 if work.settings.gps.redraw else 1)
    return _latest_batches(recent, new, kept), _mean_rollout_cost(draws)


def _first(work: Workspace) -> GuidedUpdate:
    """Returns the state before the first iteration, whose policy is fitted to the guides."""
    solutions = work.initial_solutions
    guides = _guiding_distributions(work, solutions)
    none: Batches = tuple(() for _ in guides)
    return GuidedUpdate(
        policy=work.supervised_policy(guides),
        solutions=solutions,
        lowest=float("inf"),
        regularization=_FIRST,
        guiding=tuple((_guide(work, q, i, _GUIDING_SAMPLES, k=0),) for i, q in enumerate(guides)),
        recent=none,
        adapted=none,
    )


def _latest_batches(batches: Batches, new: Sequence[_Batch], count: int) -> Batches:
    """Returns the latest `count` batches from each initial state."""
    return tuple((*old, batch)[-count:] for old, batch in zip(batches, new, strict=True))


def combine_rollouts(batches: Sequence[_Batch], observation: Observation) -> ImportanceSamples:
    """Returns the rollouts of several distributions as those of their mixture.

    Raises:
        DivergenceError: no rollout is left.
    """
    counts = [len(batch.rollouts.states) for batch in batches]
    if not sum(counts):
        raise DivergenceError(
            "Every guiding rollout diverged; lower gps.guiding_noise, or start from another state."
        )
    states, controls, costs = (
        np.concatenate([getattr(batch.rollouts, name) for batch in batches])
        for name in ("states", "controls", "costs")
    )
    densities = [batch.log_density(observation, states, controls) for batch in batches]
    return ImportanceSamples(
        observation(states), controls, costs, mixture_log_density(densities, counts)
    )


def _guiding_distributions(
    work: Workspace, solutions: Sequence[OptimizationResult]
) -> list[TrajectoryDistribution]:
    """Returns q(ζ) of the solutions with the noise that guiding rollouts are drawn with.

    Importance weights need a density, which a clamped control does not have: it gets the mean noise
    that it has where it is free. The robot cuts this noise off at the limit, which is a part of the
    dynamics: weights are of what was drawn, costs of what was applied.
    """
    factor = work.settings.gps.guiding_noise**2
    guides = []
    for q in work.taught(solutions):
        variances = np.diagonal(q.control_covariances, axis1=1, axis2=2)
        free = variances > 0.0
        mean = variances.sum(axis=0) / np.maximum(free.sum(axis=0), 1)
        mean = np.where(free.any(axis=0), mean, LEAST_NOISE**2)
        covariances = with_clamped_variances(q.control_covariances, mean)
        guides.append(replace(q, control_covariances=factor * covariances))
    return guides


def _guide(work: Workspace, q: TrajectoryDistribution, start: int, count: int, k: int) -> _Batch:
    """Draws rollouts of π_G around a solution."""
    rng = generator(work.seed, Stream.GUIDING_ROLLOUTS, k, start)
    noise = sample_rollout_noise(q, count, rng)

    def law(t: int, x: Array) -> Array:
        deviations = work.task.dynamics.space.subtract(x, q.mean.states[t])
        return q.mean.controls[t] + deviations @ q.gains[t].T + noise[:, t]

    rollouts = work.roll_out(start, count, rng, law).sound()
    return _Batch(rollouts, q)


def _mean_rollout_cost(draws: Sequence[Rollouts]) -> float:
    """Returns the mean of Σ_t c over rollouts; inf if one diverged."""
    costs = np.concatenate([rollouts.costs.sum(axis=1) for rollouts in draws])
    return float(costs.mean()) if np.isfinite(costs).all() else float("inf")
