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
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from vgps_ros.core.checks import check_array
from vgps_ros.core.marginals import control_means, sample_deviations
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy_fit import Targets
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.workspace import Update, Workspace
from vgps_ros.tasks import Task

LogWeights = Callable[[TrajectoryDistribution, Array], Array]
"""Maps q and what the policy reads of N states a step, (N, T, n_o), to log w, shape (N, T)."""


@dataclass(frozen=True)
class Imitation(Update):
    """The result of one iteration.

    Attributes:
        visited: states of the dataset for each initial state, shape (N, T, n_x), NaN after a
            rollout has diverged.
    """

    visited: tuple[Array, ...]

    def check(self, task: Task) -> None:
        """Checks the dataset, after it was read from a file."""
        for states in self.visited:
            shape = (len(states), task.horizon, task.dims["n_x"])
            check_array("visited", np.nan_to_num(states), shape)


def dagger(work: Workspace, last: Imitation | None, k: int) -> Imitation:
    """Does iteration k of plain DAGGER."""
    return imitate(work, last, k, log_weights=None, adapts=False)


def imitate(
    work: Workspace, last: Imitation | None, k: int, log_weights: LogWeights | None, *, adapts: bool
) -> Imitation:
    """Does iteration k of DAGGER or of one of its variants.

    Args:
        work: problem and settings.
        last: result of iteration k − 1; None at k = 1.
        k: the iteration.
        log_weights: weighs the dataset's states; None if all have the same weight.
        adapts: true if the DDP solutions are optimised anew against the policy (line 6).
    """
    settings = work.settings
    if last is None:
        solutions, policy = work.initial_solutions, work.supervised_policy()
        visited = tuple(
            _around(
                work.task, q, settings.fit.samples_per_step, generator(work.seed, Stream.DATASET, i)
            )
            for i, q in enumerate(work.scored(solutions))
        )
    else:
        solutions = last.solutions
        draws = work.sample_policy(last.policy, settings.policy_rollouts, k)
        visited = tuple(
            np.concatenate([states, rollouts.states])
            for states, rollouts in zip(last.visited, draws, strict=True)
        )
        targets, weights = oracle_targets(
            work.scored(solutions), visited, work.task.observation, log_weights
        )
        policy = work.fit_samples(last.policy, targets, weights, k)
    if adapts:
        solutions = work.reoptimize(solutions, policy, k)
    return Imitation(policy, solutions, visited)


def oracle_targets(
    distributions: Sequence[TrajectoryDistribution],
    visited: Sequence[Array],
    observation: Observation,
    log_weights: LogWeights | None,
) -> tuple[Targets, Array | None]:
    """Returns the oracle's actions at the visited states, and weights, which sum to 1.

    Args:
        distributions: q of each initial state.
        visited: states for each, shape (N, T, n_x), NaN after a rollout has diverged.
        observation: what the policy reads of a state.
        log_weights: weighs the states; None if all have the same weight.
    """
    rows = []
    for q, states in zip(distributions, visited, strict=True):
        finite = np.isfinite(states).all(axis=2)
        means = control_means(q, observation.space.subtract(states, q.mean.states[:-1]))
        inputs = observation(states)
        log_w = np.zeros(finite.shape) if log_weights is None else log_weights(q, inputs)
        columns = (inputs, means, log_w)
        rows.append([column[finite] for column in columns])
    inputs, means, log_w = (np.concatenate(column) for column in zip(*rows, strict=True))
    targets = Targets(inputs, means, np.zeros_like(means))
    return targets, None if log_weights is None else np.asarray(softmax(log_w))


def _around(task: Task, q: TrajectoryDistribution, samples: int, rng: np.random.Generator) -> Array:
    """Draws states from the marginals, shape (samples, T, n_x)."""
    return task.dynamics.space.add(q.mean.states[:-1], sample_deviations(q, samples, rng))
