# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Cost-weighted variational policy search, the analogue of PoWER of section 6.

    w_i ∝ exp(−α_k Σ_t c(x_t, u_t)) over rollouts ζ_i of π_θ,    θ ← argmax Σ_i w_i log π_θ(ζ_i)

"This algorithm is identical to ours, except that instead of using DDP to optimize q(ζ), the
variational distribution is formed by taking samples from the current policy and reweighting them
by the exponential of their cost. [...] The policy is still initialized with supervised training to
resemble the initial DDP solution." α goes as in Algorithm 1. A rollout that diverged has no
weight; if all diverged the policy stays as it was.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import softmax

from vgps_ros.core.observation import Observation
from vgps_ros.core.policy_fit import Targets
from vgps_ros.search.rollouts import Rollouts
from vgps_ros.search.workspace import Update, Workspace


def cost_weighted(
    work: Workspace, last: Update | None, k: int, samples: int | None = None
) -> Update:
    """Does iteration k of cost-weighted search, with so many rollouts, or as many as are set."""
    if last is None:
        return Update(work.supervised_policy(), work.initial_solutions)
    policy, settings = last.policy, work.settings
    draws = work.sample_policy(policy, samples or settings.policy_rollouts, k)
    sound = [rollouts.sound() for rollouts in draws]
    if any(len(rollouts.costs) for rollouts in sound):
        observations = [here.observation for here in work.tasks]
        targets, weights = weighted_targets(sound, observations, settings.alpha(k))
        policy = work.fit_samples(policy, targets, weights, k)
    return Update(policy, work.initial_solutions)


def cost_weights(costs: np.ndarray, alpha: float) -> np.ndarray:
    """Returns w_i, shape (N,), of the rollouts' costs Σ_t c, shape (N,)."""
    return np.asarray(softmax(-alpha * costs))


def weighted_targets(
    draws: Sequence[Rollouts], observations: Sequence[Observation], alpha: float
) -> tuple[Targets, np.ndarray]:
    """Returns the controls of the rollouts, and the weight of each step; weights sum to 1.

    All situations have the same weight; for each there are rollouts and an observation.
    """
    pairs = zip(draws, observations, strict=True)
    read = [_rows(observation(rollouts.states)) for rollouts, observation in pairs]
    drawn = [rollouts for rollouts in draws if len(rollouts.costs)]
    controls = np.concatenate([_rows(rollouts.controls) for rollouts in drawn])
    weights = np.concatenate(
        [
            np.repeat(cost_weights(rollouts.costs.sum(axis=1), alpha), rollouts.costs.shape[1])
            for rollouts in drawn
        ]
    )
    targets = Targets(np.concatenate(read), controls, np.zeros_like(controls))
    return targets, weights / weights.sum()


def _rows(array: np.ndarray) -> np.ndarray:
    return array.reshape(-1, array.shape[-1])
