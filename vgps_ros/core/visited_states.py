# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What q(ζ) would do in states that the policy itself has visited, as samples of the M-step.

The marginals of q are tied to time, and the policy is not: a robot that was held up goes on along
the same motion some steps later, so that it leaves the marginal of every step by more and more, but
not the motion. What a policy that sees no time should do in such a state is what q does at the step
τ in which q passes there,

    τ = argmax_t q(o_t),    u ~ N(ū_τ + K_τ (x ⊖ x̄_τ), Quu_τ⁻¹),

where o = h(x) is what the policy reads. Far from all marginals, the linear feedback of q means
nothing: a rollout counts until it has left them for the first time.
"""

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compile_at_first_call
from vgps_ros.core.observation import (
    LOWEST_STD,
    NO_CONTEXT,
    Observation,
    observed_marginals,
    widen_covariances,
)
from vgps_ros.core.policy_fit import Targets
from vgps_ros.core.records import Array, TrajectoryDistribution

MOST_CANDIDATES = 500  # steps of a motion with all of which a state is compared


def visited_targets(
    q: TrajectoryDistribution,
    observation: Observation,
    visited: Array,
    limit: float,
    controls: Array = NO_CONTEXT,
) -> Targets:
    """Returns what q would do in states of rollouts, up to where each of them leaves q.

    Args:
        q: the distribution that the policy learns from.
        observation: h, what the policy reads.
        visited: states of the rollouts, shape (N, T, n_x), NaN where one has diverged.
        limit: largest distance from q at the step τ, as the root mean square of a state's
            deviations in standard deviations of the marginal.
        controls: controls of the rollouts, shape (N, T, n_u), which a policy may remember.
    """
    count, length, n_x = visited.shape
    states, here = visited.reshape(-1, n_x), observation.within(q.context)
    inputs = here.along(visited, controls).reshape(len(states), -1)
    now = here.now(visited).reshape(len(states), -1) if here.past else inputs
    step, distance = likeliest_steps(q, observation, now)
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
) -> tuple[NDArray[np.int64], Array]:
    """Returns the step τ at which each input is likeliest, shape (N,), and the distance from q.

    Of a longer motion it compares each input with MOST_CANDIDATES steps at most, evenly spaced, and
    then with those around the likeliest one, so that its time hardly grows with the motion.

    Args:
        q: the distribution.
        observation: h.
        inputs: o without what is remembered, shape (N, n_o).
    """
    means, covariances = observed_marginals(q, observation)
    covariances = widen_covariances(covariances)
    # What tells most steps apart comes first, so that most are given up early.
    apart = means.var(axis=0) / np.diagonal(covariances, axis1=1, axis2=2).mean(axis=0)
    order = np.argsort(-apart)
    means, inputs = (np.ascontiguousarray(each[:, order]) for each in (means, inputs))
    covariances = np.ascontiguousarray(covariances[:, order[:, None], order])
    step, square = np.zeros(len(inputs), dtype=np.int64), np.full(len(inputs), np.nan)
    _search(means, covariances, -(-len(means) // MOST_CANDIDATES), inputs, step, square)
    return step, np.sqrt(square / inputs.shape[1])


@compile_at_first_call
def _search(means, covariances, stride, inputs, steps, squares):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the likeliest steps, and the squared Mahalanobis distances from them.

    A step is given up as soon as it is less likely than the best one so far. The first one to be
    tried is that of the input before, since inputs follow each other.
    """
    count, n = means.shape
    volumes = _lower_roots(covariances)
    whitened, last = np.empty(n), 0
    for i in range(len(inputs)):
        x = inputs[i]
        if not np.all(np.isfinite(x)):
            continue
        best, least, chosen = np.inf, np.inf, -1
        for shift in range(-1, 1 + (count - 1) // stride):
            t = last if shift < 0 else shift * stride
            square = _distance(x, means, covariances, t, best - volumes[t], whitened)
            score = square + volumes[t]
            if score < best or (score == best and t < chosen):
                best, least, chosen = score, square, t
        last = middle = chosen
        for t in range(max(middle - stride + 1, 0), min(middle + stride, count)):
            square = _distance(x, means, covariances, t, best - volumes[t], whitened)
            if square + volumes[t] < best:
                best, least, chosen = square + volumes[t], square, t
        steps[i], squares[i] = chosen, least


@compile_at_first_call
def _lower_roots(covariances):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Replaces covariances by their Cholesky factors, but inverts the diagonals of these.

    Returns the logarithms of their volumes.
    """
    volumes = np.zeros(len(covariances))
    for t, c in enumerate(covariances):
        for i in range(len(c)):
            for j in range(i + 1):
                rest = c[i, j]
                for k in range(j):
                    rest -= c[i, k] * c[j, k]
                # No direction is narrower than that; rounding can make it seem so.
                c[i, j] = 1.0 / np.sqrt(max(rest, LOWEST_STD**2)) if i == j else rest * c[j, j]
            volumes[t] -= 2.0 * np.log(c[i, i])
    return volumes


@compile_at_first_call
def _distance(x, means, roots, t, most, whitened):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns the squared distance of x from the mean at t, or inf once it is more than `most`."""
    square = 0.0
    for i in range(len(x)):
        rest = x[i] - means[t, i]
        for j in range(i):
            rest -= roots[t, i, j] * whitened[j]
        whitened[i] = rest * roots[t, i, i]
        square += whitened[i] ** 2
        if square > most:
            return np.inf
    return square


def _is_read(q: TrajectoryDistribution, observation: Observation) -> Array:
    """Returns whether each coordinate of a deviation changes what the policy reads, (n_dx,).

    Readings of two steps tell of what changes the second ones.
    """
    n_o, states = len(observation.names), q.mean.states[:-1]
    h_x = observation.pull_back(np.broadcast_to(np.eye(n_o), (len(states), n_o, n_o)), states)
    is_read = (h_x != 0.0).any(axis=(0, 1))
    if observation.past and observation.past.history:
        is_read |= (h_x[1:] @ q.linear_dynamics.f_x[:-1] != 0.0).any(axis=(0, 1))
    return np.asarray(is_read)
