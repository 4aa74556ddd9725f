# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""DAGGER with a dataset weighted by the DDP marginals, as section 6 compares with it.

    θ ← argmax Σ_(x,t) in D  (q(x_t) / q(x̄_t))^(1/n) log π_θ(ū_t + K_t (x − x̄_t) | x)

"The on-policy samples initially visited states that were very far from the DDP solution [...] To
reduce the impact of these poor states, we implemented a variant of DAGGER which weighted the
samples by their probability under the DDP marginals."

Choices where the paper leaves something open: the probability is the density of what the policy
reads of the state, relative to its largest value in the same step, so that narrow steps do not
outweigh broad ones, and per dimension (its n-th root), so that draws of the marginals keep their
weight beside rollouts close to the mean; the marginals have a standard deviation of at least 0.01
in each direction.
"""

from functools import partial

from vgps_ros.core.gaussians import squared_distance
from vgps_ros.core.observation import Observation, observed_marginals, widened
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.search.dagger import Imitation, imitate
from vgps_ros.search.workspace import Workspace


def weighted_dagger(work: Workspace, last: Imitation | None, k: int) -> Imitation:
    """Does iteration k of DAGGER on a weighted dataset."""
    weigh = partial(marginal_log_weights, observation=work.task.observation)
    return imitate(work, last, k, weigh, adapts=False)


def adapted_weighted_dagger(work: Workspace, last: Imitation | None, k: int) -> Imitation:
    """Does iteration k of the variant whose oracle adapts to the policy as q(ζ) does in vgps.

    "We also implemented an adapted variant, where the DDP solution is re-optimized at each
    iteration to match the policy (in addition to weighting)." The current solution gives the
    actions and weights of the whole dataset.
    """
    weigh = partial(marginal_log_weights, observation=work.task.observation)
    return imitate(work, last, k, weigh, adapts=True)


def marginal_log_weights(
    q: TrajectoryDistribution, inputs: Array, observation: Observation
) -> Array:
    """Returns (log q(o_t) − log q(ō_t)) / n, shape (N, T), of the n numbers that a policy reads.

    Args:
        q: distribution whose marginals weigh the states.
        inputs: o, what the policy reads of x_1 … x_T of each rollout, shape (N, T, n).
        observation: what that is.
    """
    means, covariances = observed_marginals(q, observation)
    return -0.5 * squared_distance(inputs - means, widened(covariances)) / inputs.shape[-1]
