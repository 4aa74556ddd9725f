# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Statistics over training seeds, after Agarwal et al. (NeurIPS 2021).

The interquartile mean (IQM) leaves out the best and the worst quarter of the seeds, so a seed in
five that fails does not show in it. It shows in the probability of improvement.

Intervals are of 95 %, those of a stratified bootstrap: the seeds of each sample are drawn anew by
themselves. The library rliable computes the same where all samples have as many seeds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import bootstrap, trim_mean

from vgps_ros.core.records import Array

_CONFIDENCE, _RESAMPLES = 0.95, 2000


@dataclass(frozen=True)
class Band:
    """A statistic over the seeds with its interval, each of the same shape."""

    middle: Array
    low: Array
    high: Array


def with_interval(statistic: Callable[..., Array], *samples: Array) -> Band:
    """Returns a statistic over the first axis of samples; one seed alone is drawn twice.

    The statistic takes the samples, and by its name the axis.
    """
    several = [np.repeat(each, 2, axis=0) if len(each) == 1 else each for each in samples]
    found = bootstrap(
        several, statistic, axis=0, vectorized=True, method="percentile", rng=0,
        n_resamples=_RESAMPLES, confidence_level=_CONFIDENCE,
    ).confidence_interval  # fmt: skip
    return Band(statistic(*samples, axis=0), np.asarray(found.low), np.asarray(found.high))


def interquartile_mean(sample: Array, axis: int = 0) -> Array:
    """Returns the IQM over the seeds."""
    return np.asarray(trim_mean(sample, 0.25, axis=axis))


def probability_of_improvement(ours: Sequence[Array], theirs: Sequence[Array]) -> Band:
    """Returns how probable it is that a seed of ours ends lower than one of theirs.

    It is the mean over the panels; where both end at the same figure, it is one half.

    Args:
        ours: the figures that our seeds of each panel end at, each of shape (S,).
        theirs: the same of another method.
    """

    def statistic(*samples: Array, axis: int) -> Array:
        first = [np.moveaxis(x, axis, -1)[..., :, None] for x in samples[: len(ours)]]
        other = [np.moveaxis(y, axis, -1)[..., None, :] for y in samples[len(ours) :]]
        wins = [(x < y) + 0.5 * (x == y) for x, y in zip(first, other, strict=True)]
        return np.mean([win.mean(axis=(-2, -1)) for win in wins], axis=0)

    return with_interval(statistic, *ours, *theirs)
