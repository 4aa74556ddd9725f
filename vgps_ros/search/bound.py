# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Tells by how much each step of an iteration raises the bound L(q, θ) of `core.bound`.

With q and θ as iteration k − 1 left them, at the α_k of iteration k,

    m_step_gain = L(q_{k−1}, θ_k) − L(q_{k−1}, θ_{k−1}),
    q_step_gain = L(q_k, θ_k) − L(q_{k−1}, θ_k)            [nat].

Neither is negative where both steps are exact, and neither mixes values of different α. The horizon
is the scored one, so where steps are planned beyond it, a q-step may give some of it up for them.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from vgps_ros.core.bound import expected_cost, expected_divergence
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator

if TYPE_CHECKING:  # these import torch, which a reader of metrics does without
    from vgps_ros.search.iteration import SearchState
    from vgps_ros.search.metrics import IterationMetrics
    from vgps_ros.search.workspace import Workspace

Distributions: TypeAlias = Sequence[TrajectoryDistribution]

# A step that loses less than this share of the bound is within the error of averages over samples.
_TOLERANCE = 1e-3
_REMEDIES = {
    "M-step": "raise fit.samples_per_step or lower fit.tolerance",
    "q-step": "raise policy_samples or ddp_iterations",
}


def bound_metrics(
    work: "Workspace", before: "SearchState", theta: GaussianPolicy, after: Distributions
) -> dict[str, float]:
    """Computes the metrics by name; all are means over the situations.

    Args:
        work: the run.
        before: the state at the end of iteration k − 1.
        theta: π_θ of iteration k.
        after: q_k over the scored horizon.
    """
    task, alpha = work.task, work.settings.alpha(before.k + 1)

    def cost(qs: Distributions) -> float:
        """Returns α E_q[Σ c]."""
        pairs = zip(qs, work.tasks, strict=True)
        return alpha * _mean([expected_cost(q, here.cost) for q, here in pairs])

    def divergence(qs: Distributions, policy: GaussianPolicy) -> float:
        """Returns Σ_t E_q[KL(q ‖ π_θ)], at the same points for all q and θ of the run."""
        rngs = (generator(work.seed, Stream.BOUND, i) for i in range(len(qs)))
        pairs = zip(qs, rngs, strict=True)
        return _mean([expected_divergence(q, policy, task.observation, r) for q, r in pairs])

    # θ_k was fitted to one of the pairs before, which is the one that it is nearest to.
    pairs = [(work.random_policies(1)[0], work.scored(before.initial_solutions))]
    if before.last:
        pairs = [(pair.policy, work.scored(pair.solutions)) for pair in before.last.pairs]
    fitted, i = min((divergence(qs, theta), i) for i, (_, qs) in enumerate(pairs))
    policy, qs = pairs[i]
    bound = -cost(after) - divergence(after, theta)
    return {
        "bound": bound,
        "m_step_gain": divergence(qs, policy) - fitted,
        "q_step_gain": bound + cost(qs) + fitted,
        "policy_kl": fitted / task.horizon,
    }


def lost_bound(metrics: "IterationMetrics") -> list[str]:
    """Returns a sentence for each step of an iteration that has lowered the bound."""
    gains = {"M-step": metrics.m_step_gain, "q-step": metrics.q_step_gain}
    return [
        f"The {step} of iteration {metrics.k} lowered the bound L(q, theta) by {-gain:.3g} nat to "
        f"{metrics.bound:.5g}, which it should raise: {_REMEDIES[step]} if that goes on."
        for step, gain in gains.items()
        if gain < -_TOLERANCE * abs(metrics.bound)
    ]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
