"""Guided policy search (Levine and Koltun, ICML 2013), as section 6 compares with it.

    θ ← argmax Σ_t [ −1/Z_t(θ) Σ_i w_it(θ) c(x_t, u_t) + w_r log Z_t(θ) ]

over rollouts ζ_i with importance weights w_it (see `core/importance_sampling.py`). "The GPS
algorithm first draws a fixed number of samples from the DDP solution, and then adds on-policy
samples at each iteration."

Choices where the papers leave something open: guiding rollouts are drawn with less noise than π_G,
whose broad noise at α = 1 no policy needs to reproduce; all of them and the rollouts of the latest
policies are kept; Φ is maximised from the best policy so far, by the mean cost of each policy's own
rollouts; where a policy becomes the best one w_r falls by a factor of ten, and rises where not.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.importance_sampling import (
    ImportanceSamples,
    maximize,
    mixture_log_density,
)
from vgps_ros.core.marginals import control_log_density, sample_rollout_noise
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.trajectory_optimizer import OptimizationResult
from vgps_ros.search.workspace import Rollouts, Update, Workspace

_STEP = 10.0  # factor by which w_r changes

Solutions = tuple[OptimizationResult, ...]
Adapt = Callable[[Solutions, GaussianPolicy, int], Solutions]
"""Maps solutions, the policy and k to the solutions that guide next."""


@dataclass(frozen=True)
class Batch:
    """Rollouts of one distribution.

    Attributes:
        rollouts: those that did not diverge.
        log_density: maps states (N, T, n_x) and controls (N, T, n_u) to log q(u_t|x_t), (N, T).
    """

    rollouts: Rollouts
    log_density: Callable[[Array, Array], Array]


def gps(work: Workspace) -> Iterator[Update]:
    """Runs guided policy search, whose guiding rollouts are those of the initial solutions."""
    return guided_search(work, adapt=None)


def guided_search(work: Workspace, adapt: Adapt | None) -> Iterator[Update]:
    """Runs guided policy search.

    Args:
        work: problem and settings.
        adapt: yields new solutions at the end of an iteration, whose rollouts guide too.

    Raises:
        DivergenceError: all rollouts from an initial state diverged.
    """
    settings, starts = work.settings.gps, range(len(work.starts))
    scaling, solutions = work.standardization(), work.initial_solutions
    guides = guiding_distributions(work, solutions)
    best = latest = work.supervised_policy(guides)
    lowest, w_r = np.inf, settings.initial_regularization
    guiding = [_guide(work, guides[i], i, settings.guiding_samples, k=0) for i in starts]
    recent: list[deque[Batch]] = [deque(maxlen=settings.recent) for _ in starts]
    adapted: list[deque[Batch]] = [deque(maxlen=settings.recent) for _ in starts]
    for k in count(1):
        if k > 1:
            samples = [combined([guiding[i], *adapted[i], *recent[i]]) for i in starts]
            latest = maximize(best, samples, w_r, scaling, work.settings.fit.iterations)
        draws = work.sample_policy(latest, work.settings.policy_rollouts, k)
        for i, rollouts in enumerate(draws):
            recent[i].append(Batch(rollouts.sound(), latest.log_density))
        cost = mean_cost(draws)
        if k > 1:
            w_r *= 1.0 / _STEP if cost < lowest else _STEP
            w_r = max(settings.lowest_regularization, min(w_r, settings.highest_regularization))
        if cost < lowest:
            best, lowest = latest, cost
        if adapt is not None:
            solutions = adapt(solutions, best, k)
            guides = guiding_distributions(work, solutions)
            for i in starts:
                adapted[i].append(_guide(work, guides[i], i, work.settings.policy_rollouts, k))
        yield Update(best, solutions)


def combined(batches: Sequence[Batch]) -> ImportanceSamples:
    """Returns the rollouts of several distributions as those of their mixture.

    Raises:
        DivergenceError: there is none.
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
    densities = [batch.log_density(states, controls) for batch in batches]
    return ImportanceSamples(states, controls, costs, mixture_log_density(densities, counts))


def guiding_distributions(work: Workspace, solutions: Solutions) -> list[TrajectoryDistribution]:
    """Returns q(ζ) of the solutions with the noise that guiding rollouts are drawn with."""
    factor = work.settings.gps.guiding_noise**2
    return [
        replace(q, control_covariances=factor * q.control_covariances)
        for q in work.scored(solutions)
    ]


def _guide(work: Workspace, q: TrajectoryDistribution, start: int, count: int, k: int) -> Batch:
    """Rollouts of π_G around a solution."""
    rng = generator(work.seed, Stream.GUIDING_ROLLOUTS, k, start)
    noise = sample_rollout_noise(q, count, rng)

    def law(t: int, x: Array) -> Array:
        return q.mean.controls[t] + (x - q.mean.states[t]) @ q.gains[t].T + noise[:, t]

    rollouts = work.roll_out(start, count, rng, law).sound()
    return Batch(rollouts, lambda x, u: control_log_density(q, x, u))


def mean_cost(draws: Sequence[Rollouts]) -> float:
    """Returns the mean of Σ_t c over rollouts; inf if one diverged."""
    costs = np.concatenate([rollouts.costs.sum(axis=1) for rollouts in draws])
    return float(costs.mean()) if np.isfinite(costs).all() else float("inf")
