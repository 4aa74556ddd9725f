"""Random instances of the core's records."""

import numpy as np
import pytest

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import LinearDynamics, Trajectory, TrajectoryDistribution


def _covariances(rng, count, n):
    roots = rng.standard_normal((count, n, n + 1))
    return roots @ np.swapaxes(roots, 1, 2) / n


@pytest.fixture
def random_covariances(rng):
    return lambda count, n: _covariances(rng, count, n)


@pytest.fixture
def random_policy(rng):
    """Returns a function that draws a policy of a given shape."""

    def make(observed=(0, 2, 3), hidden_units=(5,), control_dim=2, **options):
        architecture = Architecture(observed, hidden_units, control_dim, **options)
        parameters = rng.standard_normal(architecture.num_parameters)
        return GaussianPolicy(architecture, parameters, rng.uniform(0.5, 2.0, control_dim))

    return make


@pytest.fixture
def random_distribution(rng):
    """Returns a function that draws q(ζ) with unrelated, well-conditioned parts."""

    def make(horizon=6, n_x=4, n_u=2) -> TrajectoryDistribution:
        return TrajectoryDistribution(
            mean=Trajectory(
                rng.standard_normal((horizon + 1, n_x)), rng.standard_normal((horizon, n_u))
            ),
            gains=rng.standard_normal((horizon, n_u, n_x)),
            control_covariances=_covariances(rng, horizon, n_u),
            linear_dynamics=LinearDynamics(
                0.5 * rng.standard_normal((horizon, n_x, n_x)),
                rng.standard_normal((horizon, n_x, n_u)),
            ),
            state_covariances=_covariances(rng, horizon + 1, n_x),
        )

    return make
