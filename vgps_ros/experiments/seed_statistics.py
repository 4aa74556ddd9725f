# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Statistics over the seeds of an experiment, after Agarwal et al. (NeurIPS 2021).

All are of costs as multiples of the initial DDP solution's of the same seed. A policy that fell or
diverged counts as CEILING, however its robot thrashed: it is never left out, and never outweighs
all others.

The interquartile mean (IQM) leaves out the best and the worst quarter of the seeds, so a seed in
five that falls does not show in it. It shows in the profiles, and in the probabilities.

Intervals are those of a stratified bootstrap: the seeds of each panel are drawn anew by themselves.
The library rliable computes the same where all panels have as many seeds, which they need not here.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import bootstrap, trim_mean

from vgps_ros.core.records import Array
from vgps_ros.views.comparison import CEILING, Band

CONFIDENCE, RESAMPLES, LAST = 0.95, 2000, 5


def multiples(costs: Array, ddp_costs: Array) -> Array:
    """Returns costs as multiples of the initial DDP solutions', at most CEILING, as inf and NaN."""
    return np.fmin(costs / ddp_costs, CEILING)


def iqm(found: Array) -> Band:
    """Returns the IQM over the seeds of multiples (S, K), in their logarithms, and its interval."""
    logs = np.log(found)
    bounds = _interval([logs], _trimmed)
    return Band(*(np.exp(each) for each in (_trimmed(logs, axis=0), *bounds)))


def last_multiples(found: Array) -> Array:
    """Returns the geometric mean of each seed's last five multiples, (S,), of (S, K)."""
    return np.exp(np.log(found[:, -LAST:]).mean(axis=1))


def profile(panels: Sequence[Array], levels: Array) -> Band:
    """Returns which share of the seeds ends at each level (L,) or below, the mean over panels.

    Args:
        panels: the multiples that the seeds of each panel end at, each of shape (S,).
        levels: multiples, shape (L,).
    """
    below = [(found[:, None] <= levels).astype(float) for found in panels]
    return Band(_mean_of_means(*below, axis=0), *_interval(below, _mean_of_means))


def probability_of_improvement(ours: Sequence[Array], theirs: Sequence[Array]) -> Band:
    """Returns how probable it is that a seed of ours ends lower than one of theirs.

    It is the mean over the panels; where both end at the same multiple, as two that fall do, it is
    one half.

    Args:
        ours: the multiples that our seeds of each panel end at, each of shape (S,).
        theirs: the same of another method.
    """

    def statistic(*samples: Array, axis: int) -> Array:
        moved = [np.moveaxis(sample, axis, -1) for sample in samples]
        pairs = zip(moved[: len(ours)], moved[len(ours) :], strict=True)
        wins = [np.sign(y[..., None, :] - x[..., :, None]) for x, y in pairs]
        return np.mean([0.5 + 0.5 * each.mean(axis=(-2, -1)) for each in wins], axis=0)

    samples = [*ours, *theirs]
    return Band(statistic(*samples, axis=0), *_interval(samples, statistic))


def _trimmed(sample: Array, axis: int) -> Array:
    return np.asarray(trim_mean(sample, 0.25, axis=axis))


def _mean_of_means(*samples: Array, axis: int) -> Array:
    return np.mean([sample.mean(axis=axis) for sample in samples], axis=0)


def _interval(samples: Sequence[Array], statistic: Callable[..., Array]) -> tuple[Array, Array]:
    """Returns the bounds of a statistic over the first axis; one seed alone is drawn twice."""
    several = [np.repeat(each, 2, axis=0) if len(each) == 1 else each for each in samples]
    found = bootstrap(
        several, statistic, axis=0, vectorized=True, method="percentile", rng=0,
        n_resamples=RESAMPLES, confidence_level=CONFIDENCE,
    ).confidence_interval  # fmt: skip
    return np.asarray(found.low), np.asarray(found.high)
