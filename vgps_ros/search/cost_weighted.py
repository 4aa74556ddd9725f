"""Cost-weighted variational policy search, the analogue of PoWER of section 6.

    w_i ∝ exp(−α_k Σ_t c(x_t, u_t)) over rollouts ζ_i of π_θ,    θ ← argmax Σ_i w_i log π_θ(ζ_i)

"This algorithm is identical to ours, except that instead of using DDP to optimize q(ζ), the
variational distribution is formed by taking samples from the current policy and reweighting them
by the exponential of their cost. [...] The policy is still initialized with supervised training to
resemble the initial DDP solution." α falls as in Algorithm 1; a rollout that diverged weighs
nothing, and where all did the policy stays.
"""

from collections.abc import Iterator, Sequence
from itertools import count, repeat

import numpy as np
from scipy.special import softmax

from vgps_ros.core.policy_fit import Targets, fit_to_targets
from vgps_ros.search.workspace import Rollouts, Update, Workspace

_NEGLIGIBLE = 1e-12  # weight beside the largest one below which a rollout cannot matter


def cost_weighted(work: Workspace, samples: int | None = None) -> Iterator[Update]:
    """Runs cost-weighted search.

    Args:
        work: problem and settings.
        samples: rollouts per initial state and iteration; None for what the settings say.
    """
    scaling, settings = work.standardization(), work.settings
    policy = work.supervised_policy()
    for k in count(1):
        if k > 1:
            draws = work.sample_policy(policy, samples or settings.policy_samples, k)
            sound = [rollouts.sound() for rollouts in draws]
            if any(len(rollouts.costs) for rollouts in sound):
                targets = weighted_targets(sound, settings.alpha(k))
                policy = fit_to_targets(policy, repeat(targets), scaling, settings.fit)
        yield Update(policy, work.initial_solutions)


def cost_weights(costs: np.ndarray, alpha: float) -> np.ndarray:
    """Returns w_i, shape (N,), of the rollouts' costs Σ_t c, shape (N,)."""
    return np.asarray(softmax(-alpha * costs))


def weighted_targets(draws: Sequence[Rollouts], alpha: float) -> Targets:
    """Returns the controls of the rollouts, weighted; each initial state counts alike."""
    columns = []
    for rollouts in draws:
        if not len(rollouts.costs):
            continue
        weights = cost_weights(rollouts.costs.sum(axis=1), alpha)
        kept = weights > _NEGLIGIBLE * weights.max()
        states, controls = rollouts.states[kept], rollouts.controls[kept]
        steps = np.repeat(weights[kept], states.shape[1])
        columns.append((_rows(states), _rows(controls), steps))
    states, controls, weights = (np.concatenate(column) for column in zip(*columns, strict=True))
    return Targets(states, controls, np.zeros_like(controls), weights / weights.sum())


def _rows(array: np.ndarray) -> np.ndarray:
    return array.reshape(-1, array.shape[-1])
