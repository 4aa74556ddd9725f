# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Targets of the M-step in states that the policy itself has visited.

The marginals of q are tied to time, and the policy is not: a robot that was held up goes on along
the same motion some steps later, so that it leaves the marginal of every step by more and more,
but not the motion. What a policy that sees no time should do in such a state is what q does at the
step τ in which q passes there,

    τ = argmax_t q(o_t),    u ~ N(ū_τ + K_τ (x ⊖ x̄_τ), Quu_τ⁻¹),

where o = h(x) is what the policy reads. Far from all marginals, the linear feedback of q means
nothing: a rollout counts until it has left them for the first time.
"""

import numpy as np

from vgps_ros.core.observation import LOWEST_STD, Observation, observed_marginals, widened
from vgps_ros.core.policy_fit import Targets
from vgps_ros.core.records import Array, TrajectoryDistribution

MOST_CANDIDATES = 500  # steps of a motion with all of which a state is compared


def visited_targets(
    q: TrajectoryDistribution, observation: Observation, visited: Array, limit: float
) -> Targets:
    """Returns what q would do in states of rollouts, up to where each of them leaves q.

    Args:
        q: the distribution that the policy learns from.
        observation: h, what the policy reads.
        visited: states of the rollouts, shape (N, T, n_x), NaN where one has diverged.
        limit: largest distance from q at the step τ, as the root mean square of a state's
            deviations in standard deviations of the marginal.
    """
    count, length, n_x = visited.shape
    states = visited.reshape(-1, n_x)
    inputs = observation(states)
    step, distance = likeliest_steps(q, observation, inputs)
    is_near = distance <= limit  # false where it is NaN
    kept = np.logical_and.accumulate(is_near.reshape(count, length), axis=1).ravel()
    states, inputs, step = states[kept], inputs[kept], step[kept]
    deviations = observation.space.subtract(states, q.mean.states[step])
    # What the policy cannot read, such as how far it has come, must not be in its targets.
    deviations *= _is_read(q, observation)
    means = q.mean.controls[step] + np.einsum("nux,nx->nu", q.gains[step], deviations)
    variances = np.diagonal(q.control_covariances, axis1=1, axis2=2)[step]
    return Targets(inputs, means, variances)


def likeliest_steps(
    q: TrajectoryDistribution, observation: Observation, inputs: Array
) -> tuple[Array, Array]:
    """Returns the step τ at which each input is likeliest, shape (N,), and the distance from q.

    Of a longer motion it compares each input with MOST_CANDIDATES steps at most, evenly spaced, and
    then with those around the likeliest one, so that its time hardly grows with the motion.

    Args:
        q: the distribution.
        observation: h.
        inputs: o, shape (N, n_o).
    """
    means, covariances = observed_marginals(q, observation)
    variances, axes = np.linalg.eigh(widened(covariances))
    variances = np.maximum(variances, LOWEST_STD**2)  # rounding can make them negative
    whitening = axes / np.sqrt(variances)[:, None, :]
    volumes = np.log(variances).sum(axis=1)
    stride = -(-len(means) // MOST_CANDIDATES)
    coarse = np.arange(0, len(means), stride)
    deviations = ((inputs - means[t]) @ whitening[t] for t in coarse)
    squares = np.stack([np.einsum("ni,ni->n", d, d) for d in deviations])
    chosen = (squares + volumes[coarse, None]).argmin(axis=0)
    begin, square = coarse[chosen], squares[chosen, np.arange(len(inputs))]
    step = begin
    for shift in (*range(1 - stride, 0), *range(1, stride)):
        near = np.clip(begin + shift, 0, len(means) - 1)
        d = np.einsum("ni,nij->nj", inputs - means[near], whitening[near])
        other = np.einsum("ni,ni->n", d, d)
        is_likelier = other + volumes[near] < square + volumes[step]
        step = np.where(is_likelier, near, step)
        square = np.where(is_likelier, other, square)
    return step, np.sqrt(square / inputs.shape[1])


def _is_read(q: TrajectoryDistribution, observation: Observation) -> Array:
    """Returns whether each coordinate of a deviation changes what the policy reads, (n_dx,)."""
    n_o, states = len(observation.names), q.mean.states[:-1]
    h_x = observation.pull_back(np.broadcast_to(np.eye(n_o), (len(states), n_o, n_o)), states)
    return np.asarray((h_x != 0.0).any(axis=(0, 1)))
