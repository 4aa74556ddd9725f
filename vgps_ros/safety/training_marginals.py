# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Measures how far a state is from the states of the training.

The distance of x is the Mahalanobis distance of what the policy reads of it, o = h(x), from the
nearest of the marginals q(o_t),

    d(x) = min_t √((o − ō_t)ᵀ Σ_t⁻¹ (o − ō_t)),

over the n numbers that the policy reads. The minimum is over all times, since the policy does
not depend on time. States like those of the training have distances of about √n or less. What the
policy is told, commands and a clock, is known exactly along q, so that it has a standard deviation
of its own.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vgps_ros.core.checks import check_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import NO_CONTEXT, Observation, observed_marginals, widen_covariances
from vgps_ros.core.records import Array, TrajectoryDistribution

# A derivative that is smaller than this share of a reading's largest is a difference's rounding.
_ROUNDING = 1e-5


@dataclass(frozen=True)
class Nearest:
    """The marginal that is nearest to a state."""

    distance: float  # the distance d(x); NaN if it overflows
    marginals: "TrainingMarginals"  # the training marginals that it belongs to
    step: int  # its time step t


class TrainingMarginals:
    """Holds the marginals of one q(ζ) in a form that is fast to query.

    Args:
        distribution: q(ζ).
        observation: h, what the policy reads of a state.
        control_dim: n_u.
        told_std: standard deviations of the numbers of the context that the policy reads, shape
            (c,), in their units.

    Raises:
        InvalidInputError: the distribution has no steps or other dimensions, or a Σ_t is not a
            covariance.
    """

    def __init__(
        self,
        distribution: TrajectoryDistribution,
        observation: Observation,
        control_dim: int,
        told_std: Array = NO_CONTEXT,
    ):
        observation = observation.now  # what is remembered has no marginals of its own
        q, n, space = distribution, len(observation.names), observation.space
        if not q.mean.horizon:
            raise InvalidInputError("The distribution has no steps, but it must have at least 1.")
        check_array("mean.states", q.mean.states, (q.mean.horizon + 1, space.state_dim))
        check_array("mean.controls", q.mean.controls, (q.mean.horizon, control_dim))
        means, covariances = observed_marginals(q, observation)
        told = np.diag(np.concatenate([np.zeros(n - len(told_std)), told_std**2]))
        try:
            roots = np.linalg.cholesky(widen_covariances(covariances) + told)
        except np.linalg.LinAlgError as error:
            raise InvalidInputError(
                "The state_covariances have a matrix that is not positive semidefinite, but each "
                "must be the covariance of a state."
            ) from error
        self._mean, self._gains = q.mean, q.gains
        self._observation, self._space = observation, space
        # The feedback acts on coordinates that the policy feels somewhere along the mean.
        everywhere = np.broadcast_to(np.eye(n), (q.mean.horizon, n, n))
        largest = np.abs(observation.pull_back(everywhere, q.mean.states[:-1])).max(axis=0)
        self._answers = (largest > _ROUNDING * largest.max(axis=1, keepdims=True)).any(axis=0)
        # With Σ = L Lᵀ, d is the norm of L⁻¹ o − L⁻¹ ō. The rows of L⁻¹ of all steps are stacked,
        # so that a query needs one product only.
        whitening = np.linalg.inv(roots)
        self._offsets = np.einsum("tij,tj->ti", whitening, means)
        self._whitening = whitening.reshape(-1, n)

    def nearest(self, state: Array, context: Array = NO_CONTEXT) -> Nearest:
        """Returns the marginal that is nearest to a state (n_x,) in a context (n_z,)."""
        inputs = self._observation.within(context)(state)
        with np.errstate(over="ignore", invalid="ignore"):
            whitened = self._whitening @ inputs
            deviations = whitened.reshape(self._offsets.shape) - self._offsets
            squares = np.einsum("ti,ti->t", deviations, deviations)
        step = int(np.argmin(squares))
        return Nearest(float(np.sqrt(squares[step])), self, step)

    def feedback(self, state: Array, step: int) -> Array:
        """Returns ū_t + K_t (x ⊖ x̄_t), shape (n_u,) [N·m], over coordinates the policy feels."""
        deviation = self._space.subtract(state, self._mean.states[step]) * self._answers
        # A sum of one order, since BLAS would choose the order by the processor.
        return self._mean.controls[step] + (self._gains[step] * deviation).sum(axis=1)


def nearest_of(
    marginals: Iterable[TrainingMarginals], state: Array, context: Array = NO_CONTEXT
) -> Nearest | None:
    """Returns the nearest marginal of several distributions, or None if there is none."""
    found = (each.nearest(state, context) for each in marginals)
    return min(found, key=lambda nearest: nearest.distance, default=None)
