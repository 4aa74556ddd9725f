"""How far a state is from what training has seen, and what the DDP solution would do there.

The distance of x is the Mahalanobis distance from the nearest of the marginals q(x_t),

    d(x) = min_t √((x − x̄_t)ᵀ Σ_t⁻¹ (x − x̄_t)),

over the coordinates that the policy reads: the policy is stationary, and where the robot's root is
does not count. Near the training it is about √n or below, for n coordinates.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vgps_ros.core.checks import check_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.marginals import observed_covariances
from vgps_ros.core.records import Array, TrajectoryDistribution


@dataclass(frozen=True)
class Nearest:
    """The marginal nearest to a state.

    Attributes:
        distance: d(x); NaN where it overflows.
        marginals: those that it belongs to.
        step: t.
    """

    distance: float
    marginals: "TrainingMarginals"
    step: int


class TrainingMarginals:
    """The marginals of one q(ζ), prepared for fast queries.

    Args:
        distribution: q(ζ).
        observed: the n coordinates that count.
        dims: n_x and n_u that it must have.

    Raises:
        InvalidInputError: it has no steps or other dimensions, or a Σ_t is no covariance.
    """

    def __init__(
        self, distribution: TrajectoryDistribution, observed: tuple[int, ...], dims: tuple[int, int]
    ):
        q, (n_x, n_u), n = distribution, dims, len(observed)
        if not q.mean.horizon:
            raise InvalidInputError("The distribution has no steps, but it must have some.")
        check_array("mean.states", q.mean.states, (q.mean.horizon + 1, n_x))
        check_array("mean.controls", q.mean.controls, (q.mean.horizon, n_u))
        try:
            roots = np.linalg.cholesky(observed_covariances(q, observed))
        except np.linalg.LinAlgError as error:
            raise InvalidInputError(
                "The state_covariances have a matrix that is not positive semidefinite, but each "
                "must be the covariance of a state."
            ) from error
        self._mean, self._gains = q.mean, q.gains
        self._observed = list(observed)
        # d is the norm of L⁻¹ x − L⁻¹ x̄, for Σ = L Lᵀ: one product with the rows of all steps.
        whitening = np.linalg.inv(roots)
        means = q.mean.states[:-1, self._observed]
        self._offsets = np.einsum("tij,tj->ti", whitening, means)
        self._whitening = whitening.reshape(-1, n)

    def nearest(self, state: Array) -> Nearest:
        """Returns the marginal nearest to a state, shape (n_x,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            whitened = self._whitening @ state[self._observed]
            deviations = whitened.reshape(self._offsets.shape) - self._offsets
            squares = np.einsum("ti,ti->t", deviations, deviations)
        step = int(np.argmin(squares))
        return Nearest(float(np.sqrt(squares[step])), self, step)

    def feedback(self, state: Array, step: int) -> Array:
        """Returns ū_t + K_t (x − x̄_t), shape (n_u,), [N·m]; only observed coordinates deviate."""
        deviation = np.zeros_like(state)
        deviation[self._observed] = (state - self._mean.states[step])[self._observed]
        return self._mean.controls[step] + self._gains[step] @ deviation


def nearest_of(marginals: Iterable[TrainingMarginals], state: Array) -> Nearest | None:
    """Returns the nearest marginal of several distributions; None if there is none."""
    found = (each.nearest(state) for each in marginals)
    return min(found, key=lambda nearest: nearest.distance, default=None)
