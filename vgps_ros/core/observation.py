# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The protocol of an observation o = h(x), which is all that a policy reads of a state.

A policy may know less than the optimiser does (section 5): joint angles or their sines and
cosines, velocities, sensors. `vgps_ros.simulation.readings` implements it for MuJoCo models.
"""

from typing import Protocol

import numpy as np

from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.records import Array, TrajectoryDistribution

# Least standard deviation in each direction where a density or distance needs an inverse, since a
# coordinate of x_1 may be exact [m, rad, m/s, rad/s].
LOWEST_STD = 0.01


class Observation(Protocol):
    """o = h(x) with its derivatives.

    Attributes:
        space: space of the states.
        names: name of each number that is read; there are n_o.
    """

    space: StateSpace
    names: tuple[str, ...]

    def __call__(self, states: Array) -> Array:
        """Returns h(x), shape (..., n_o), for states (..., n_x)."""

    def pull_back(self, jacobians: Array, states: Array) -> Array:
        """Returns J ∂h/∂δ, shape (..., m, n_dx), for J (..., m, n_o) at states (..., n_x)."""


def observed_marginals(
    distribution: TrajectoryDistribution, observation: Observation
) -> tuple[Array, Array]:
    """Returns the means and covariances of h(x_t) at t = 1 … T, to first order.

    The shape of the means is (T, n_o), that of the covariances (T, n_o, n_o).
    """
    states = distribution.mean.states[:-1]
    n_o = len(observation.names)
    h_x = observation.pull_back(np.broadcast_to(np.eye(n_o), (len(states), n_o, n_o)), states)
    covariances = h_x @ distribution.state_covariances[:-1] @ np.swapaxes(h_x, 1, 2)
    return observation(states), covariances


def widened(covariances: Array) -> Array:
    """Returns covariances (..., n, n) with LOWEST_STD added in each direction, so invertible."""
    return covariances + LOWEST_STD**2 * np.eye(covariances.shape[-1])
