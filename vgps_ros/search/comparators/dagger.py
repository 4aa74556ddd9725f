# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""DAGGER (Ross, Gordon and Bagnell, AISTATS 2011) with DDP as its oracle, as section 6 uses it.

    θ ← argmax Σ_(x,t) in D  w(x, t) log π_θ(ū_t + K_t (x − x̄_t) | x)
    D ← D ∪ rollouts of π_θ

"At each iteration, DAGGER adds samples from the current policy to a dataset, and then optimizes the
policy to take the oracle action at each dataset state." The oracle is the mean of the DDP
solution's local policy; plain DAGGER has w = 1.

Choices where the paper leaves something open: the dataset begins with states drawn from the DDP
marginals; a fit draws as many of its states as ours draws from the marginals; a rollout's steps
after its divergence are left out.

The weighted variant has w = (q(x_t) / q(x̄_t))^(1/n): "The on-policy samples initially visited
states that were very far from the DDP solution [...] To reduce the impact of these poor states, we
implemented a variant of DAGGER which weighted the samples by their probability under the DDP
marginals." The probability is the density of what the policy reads of the state, relative to its
largest value in the same step, so that narrow steps do not outweigh broad ones, and per dimension
(its n-th root), so that draws of the marginals keep their weight beside rollouts close to the mean;
the marginals have a standard deviation of at least 0.01 in each direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from vgps_ros.core.gaussians import squared_distance
from vgps_ros.core.marginals import control_means, sample_deviations
from vgps_ros.core.observation import Observation, observed_marginals, widen_covariances
from vgps_ros.core.policy_fit import Targets
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.workspace import Update, Workspace
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class Imitation(Update):
    """The result of one iteration.

    Attributes:
        visited: states of the dataset for each initial state, shape (N, T, n_x), NaN after a
            rollout has diverged.
    """

    visited: tuple[Array, ...]


def imitate(
    work: Workspace, last: Imitation | None, k: int, *, weighted: bool, adapts: bool
) -> Imitation:
    """Does iteration k of DAGGER, or of a variant that weighs its dataset.

    A variant may adapt, too: "We also implemented an adapted variant, where the DDP solution is
    re-optimized at each iteration to match the policy (in addition to weighting)." The current
    solution then gives the actions and weights of the whole dataset.
    """
    settings = work.settings
    if last is None:
        solutions, policy = work.initial_solutions, work.supervised_policy()
        visited = tuple(
            _around(
                work.task, q, settings.fit.samples_per_step, generator(work.seed, Stream.DATASET, i)
            )
            for i, q in enumerate(work.taught(solutions))
        )
    else:
        solutions = last.solutions
        draws = work.sample_policy(last.policy, settings.policy_rollouts, k)
        visited = tuple(
            np.concatenate([states, rollouts.states])
            for states, rollouts in zip(last.visited, draws, strict=True)
        )
        targets, weights = oracle_targets(
            work.taught(solutions), visited, work.task.observation, weighted=weighted
        )
        policy = work.fit_samples(last.policy, targets, weights, k)
    if adapts:
        solutions = work.reoptimize(solutions, policy, k)
    return Imitation(policy, solutions, visited)


def oracle_targets(
    distributions: Sequence[TrajectoryDistribution],
    visited: Sequence[Array],
    observation: Observation,
    *,
    weighted: bool,
) -> tuple[Targets, Array | None]:
    """Returns the oracle's actions at the visited states, and weights, if any, which sum to 1.

    The visited states of each q have shape (N, T, n_x), NaN after a rollout has diverged.
    """
    rows = []
    for q, states in zip(distributions, visited, strict=True):
        finite = np.isfinite(states).all(axis=2)
        means = control_means(q, observation.space.subtract(states, q.mean.states[:-1]))
        inputs = observation.within(q.context)(states)
        log_w = marginal_log_weights(q, inputs, observation) if weighted else np.zeros(finite.shape)
        columns = (inputs, means, log_w)
        rows.append([column[finite] for column in columns])
    inputs, means, log_w = (np.concatenate(column) for column in zip(*rows, strict=True))
    targets = Targets(inputs, means, np.zeros_like(means))
    return targets, np.asarray(softmax(log_w)) if weighted else None


def _around(task: Task, q: TrajectoryDistribution, samples: int, rng: np.random.Generator) -> Array:
    """Draws states from the marginals, shape (samples, T, n_x)."""
    return task.dynamics.space.add(q.mean.states[:-1], sample_deviations(q, samples, rng))


def marginal_log_weights(
    q: TrajectoryDistribution, inputs: Array, observation: Observation
) -> Array:
    """Returns (log q(o_t) − log q(ō_t)) / n, shape (N, T), of the n numbers that a policy reads.

    The inputs are o, what it reads of x_1 … x_T of each rollout, shape (N, T, n).
    """
    means, covariances = observed_marginals(q, observation)
    return (
        -0.5 * squared_distance(inputs - means, widen_covariances(covariances)) / inputs.shape[-1]
    )
