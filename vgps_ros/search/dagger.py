"""DAGGER (Ross, Gordon and Bagnell, AISTATS 2011) with DDP as its oracle, as section 6 uses it.

    θ ← argmax Σ_(x,t) in D  w(x, t) log π_θ(ū_t + K_t (x − x̄_t) | x)
    D ← D ∪ rollouts of π_θ

"At each iteration, DAGGER adds samples from the current policy to a dataset, and then optimizes the
policy to take the oracle action at each dataset state." The oracle is the mean of the DDP
solution's local policy; plain DAGGER has w = 1.

Choices where the paper leaves something open: the dataset begins with states drawn from the DDP
marginals; a fit draws as many of its states as ours draws from the marginals; what a rollout does
after it has diverged is left out.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count

import numpy as np
from scipy.special import softmax

from vgps_ros.core.marginals import control_means, sample_deviations
from vgps_ros.core.policy_fit import Targets
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.workspace import Update, Workspace

LogWeights = Callable[[TrajectoryDistribution, Array], Array]
"""Maps q and states (N, T, n_x) to log w of each, shape (N, T)."""


def dagger(work: Workspace) -> Iterator[Update]:
    """Runs plain DAGGER."""
    return imitate(work, log_weights=None, adapts=False)


def imitate(work: Workspace, log_weights: LogWeights | None, *, adapts: bool) -> Iterator[Update]:
    """Runs DAGGER or one of its variants.

    Args:
        work: problem and settings.
        log_weights: weighs the dataset's states; None if all count alike.
        adapts: whether the DDP solutions are optimised anew against the policy (line 6).
    """
    settings = work.settings
    solutions, policy = work.initial_solutions, work.supervised_policy()
    visited = [
        [_around(q, settings.fit.samples_per_step, generator(work.seed, Stream.DATASET, i))]
        for i, q in enumerate(work.scored(solutions))
    ]
    for k in count(1):
        if k > 1:
            draws = work.sample_policy(policy, settings.policy_rollouts, k)
            for states, rollouts in zip(visited, draws, strict=True):
                states.append(rollouts.states)
            targets, weights = oracle_targets(
                work.scored(solutions), [np.concatenate(v) for v in visited], log_weights
            )
            policy = work.fit_samples(policy, targets, weights, k)
        if adapts:
            solutions = work.reoptimize(solutions, policy, k)
        yield Update(policy, solutions)


def oracle_targets(
    distributions: Sequence[TrajectoryDistribution],
    visited: Sequence[Array],
    log_weights: LogWeights | None,
) -> tuple[Targets, Array | None]:
    """Returns the oracle's actions at the visited states, and the weights of these, with the sum 1.

    Args:
        distributions: q of each initial state.
        visited: states of each, shape (N, T, n_x), NaN where a rollout had diverged.
        log_weights: weighs them.
    """
    rows = []
    for q, states in zip(distributions, visited, strict=True):
        finite = np.isfinite(states).all(axis=2)
        means = control_means(q, states - q.mean.states[:-1])
        log_w = np.zeros(finite.shape) if log_weights is None else log_weights(q, states)
        columns = (states, means, log_w)
        rows.append([column[finite] for column in columns])
    states, means, log_w = (np.concatenate(column) for column in zip(*rows, strict=True))
    targets = Targets(states, means, np.zeros_like(means))
    return targets, None if log_weights is None else np.asarray(softmax(log_w))


def _around(q: TrajectoryDistribution, samples: int, rng: np.random.Generator) -> Array:
    """Draws states from the marginals, shape (samples, T, n_x)."""
    return q.mean.states[:-1] + sample_deviations(q, samples, rng)
