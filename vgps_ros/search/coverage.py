# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compares the marginals of q, which are linearised, with rollouts of q on the true dynamics.

Both steps of the method trust N(x̄_t, Σ_t) (section 4). Where the linearisation holds, 95 % of the
coordinates of rollouts of π_G, with its noise, lie within two of its standard deviations.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vgps_ros.core.marginals import sample_deviations, sample_rollout_noise
from vgps_ros.core.records import TrajectoryDistribution

if TYPE_CHECKING:
    from vgps_ros.search.metrics import IterationMetrics
    from vgps_ros.tasks import Task

_ROLLOUTS = 4  # of each q
# What two standard deviations cover of a Gaussian that is twice as wide as predicted.
LEAST_COVERAGE = 0.68


def coverage(task: "Task", q: TrajectoryDistribution, rng: np.random.Generator) -> float:
    """Returns the share of the coordinates that lie within two sd of q's marginals, in [0, 1].

    Those of a rollout that diverged do not, and coordinates without any spread do not count.

    Args:
        task: the true dynamics.
        q: the trajectory distribution, over the steps to compare.
        rng: source of the starts and of the noise.
    """
    dynamics, space = task.dynamics, task.dynamics.space
    starts = space.add(q.mean.states[0], sample_deviations(q, _ROLLOUTS, rng)[:, 0])
    controls = q.mean.controls + sample_rollout_noise(q, _ROLLOUTS, rng)
    motions = [
        motion.states
        for start, u in zip(starts, controls, strict=True)
        for motion in dynamics.follow_each(start, [replace(q.mean, controls=u)], q.gains)
    ]
    deviations = np.abs(space.subtract(np.stack(motions), q.mean.states))
    std = np.sqrt(np.diagonal(q.state_covariances, axis1=1, axis2=2))
    return float(np.mean((deviations <= 2.0 * std)[:, std > 0.0]))


def lost_coverage(metrics: "IterationMetrics") -> list[str]:
    """Returns a sentence if the linearisation no longer holds after an iteration."""
    if metrics.coverage >= LEAST_COVERAGE:
        return []
    found, least = (f"{100.0 * share:.0f} %" for share in (metrics.coverage, LEAST_COVERAGE))
    return [
        f"The linearised dynamics of iteration {metrics.k} hold no longer: two standard deviations "
        f"of q's marginals cover {found} of its rollouts, not 95 %, and less than {least}; raise "
        "alpha, with which the noise falls, or the task's std_limit where it cuts them."
    ]
