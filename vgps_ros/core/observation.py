# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""An observation o = (h(x), m, z), which is all that a policy reads.

h(x) are readings of the state: joint angles or their sines and cosines, velocities, sensors. A
policy may know less than the optimiser does (section 5). z is the context of the step, commands and
a clock: the task tells them to the optimiser ahead, and to the policy as it runs, so nothing is
differentiated along them. m is what the policy remembers of former steps (`core.memory`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.marginals import Histories, sample_deviations, sample_histories
from vgps_ros.core.memory import PastInputs
from vgps_ros.core.records import Array, Trajectory, TrajectoryDistribution

# Least standard deviation in each direction where a density or distance needs an inverse, since a
# coordinate of x_1 may be exact [m, rad, m/s, rad/s].
LOWEST_STD = 0.01

NO_CONTEXT = np.empty(0)  # of a task that has neither commands nor a clock


class StateReadings(Protocol):
    """h(x) with its derivatives; `vgps_ros.simulation.readings` has one for MuJoCo models.

    Attributes:
        space: space of the states.
        names: name of each number that is read.
    """

    space: StateSpace
    names: tuple[str, ...]

    def __call__(self, states: Array) -> Array:
        """Returns h(x), shape (..., r), for states (..., n_x)."""

    def pull_back(self, jacobians: Array, states: Array) -> Array:
        """Returns J ∂h/∂δ, shape (..., m, n_dx), for J (..., m, r) at states (..., n_x)."""


@dataclass(frozen=True)
class Observation:
    """o = (h(x), m, z), of the n_o numbers that a policy reads, with its derivatives by the state.

    Attributes:
        readings: h.
        told: names of the numbers of the context that the policy reads; they come last.
        columns: the places of these numbers in a context.
        context: z of each step, shape (T, n_z), or (N, T, n_z) of N motions, or of the only step,
            (n_z,); see `within`.
        past: m; None: the policy reads nothing of former steps.
    """

    readings: StateReadings
    told: tuple[str, ...] = ()
    columns: tuple[int, ...] = ()
    context: Array | None = None
    past: PastInputs | None = None

    @classmethod
    def of(
        cls,
        readings: StateReadings,
        told: Sequence[str],
        context: Sequence[str],
        past: PastInputs | None = None,
    ) -> "Observation":
        """Returns the observation of readings and of some numbers of a context of these names."""
        places = tuple(list(context).index(name) for name in told)
        return cls(readings, tuple(told), places, past=past)

    def within(self, context: Array) -> "Observation":
        """Returns the observation where the context of the steps is z, shape (T, n_z) or (n_z,)."""
        return replace(self, context=context) if self.told else self

    @property
    def space(self) -> StateSpace:
        """The space of the states."""
        return self.readings.space

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the numbers."""
        return (*self.readings.names, *(self.past.names if self.past else ()), *self.told)

    @property
    def now(self) -> "Observation":
        """The observation without what is remembered."""
        return replace(self, past=None) if self.past else self

    def values_told(self) -> Array:
        """Returns what is read of the context, shape (T, c) or (c,)."""
        if not self.told:
            return NO_CONTEXT
        assert self.context is not None  # `within` comes first
        return self.context[..., self.columns]

    def __call__(self, states: Array, memory: Array | None = None) -> Array:
        """Returns o, shape (..., n_o), for states (..., n_x).

        Where the context has steps, the states are those of its first steps, (..., T, n_x); a
        single state is that of the first one.

        Args:
            states: shape (..., n_x).
            memory: m, shape (..., n_m); None: each state is a first one.
        """
        read = self.readings(states)
        if self.past and memory is None:
            rows = read.reshape(-1, read.shape[-1])
            first = self.past.numbers(self.past.following(None, rows))
            read = first.reshape(*read.shape[:-1], -1)
        elif memory is not None:
            read = np.concatenate([read, memory], axis=-1)
        if not self.told:
            return read
        told = self.values_told()
        if told.ndim > 1:
            told = told[..., : states.shape[-2], :] if states.ndim > 1 else told[0]
        told = np.broadcast_to(told, (*states.shape[:-1], len(self.told)))
        return np.concatenate([read, told], axis=-1)

    def along(self, states: Array, controls: Array) -> Array:
        """Returns o of motions from their starts, shape (..., T, n_o).

        Args:
            states: shape (..., T, n_x).
            controls: shape (..., T, n_u).
        """
        if not self.past:
            return self(states)
        return self(states, self.past.along(self.readings(states), controls))

    def remembered(self, nominal: Trajectory, drawn: Histories) -> Array | None:
        """Returns m in samples around a trajectory, shape (S, T, n_m); None if there is none."""
        if not self.past:
            return None
        steps = np.arange(nominal.horizon)
        read = [
            self.readings(
                self.space.add(nominal.states[np.maximum(steps - lag, 0)], drawn.states[lag])
            )
            for lag in range(1, self.past.history + 1)
        ]
        return self.past.joined(read, np.roll(nominal.controls, 1, axis=0) + drawn.controls)

    def pull_back(self, jacobians: Array, states: Array) -> Array:
        """Returns J ∂h/∂δ, shape (..., m, n_dx), for J = ∂μ/∂o (..., m, n_o); m stays as it is."""
        return self.readings.pull_back(jacobians[..., : len(self.readings.names)], states)


def sample_inputs(
    q: TrajectoryDistribution, observation: Observation, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draws δx from q(x_t), shape (count, T, n_dx), and o with it, shape (count, T, n_o)."""
    memory = None
    if observation.past:
        drawn = sample_histories(q, count, observation.past.length, rng)
        deviations, memory = drawn.states[0], observation.remembered(q.mean, drawn)
    else:
        deviations = sample_deviations(q, count, rng)
    states = observation.space.add(q.mean.states[:-1], deviations)
    return deviations, observation.within(q.context)(states, memory)


def observed_marginals(
    distribution: TrajectoryDistribution, observation: Observation
) -> tuple[Array, Array]:
    """Returns the means and covariances of h(x_t) and z_t at t = 1 … T, to first order.

    The memory is not among them. The shape of the means is (T, n_o), that of the covariances
    (T, n_o, n_o).
    """
    states = distribution.mean.states[:-1]
    observation = observation.now.within(distribution.context)
    n_o = len(observation.names)
    h_x = observation.pull_back(np.broadcast_to(np.eye(n_o), (len(states), n_o, n_o)), states)
    covariances = h_x @ distribution.state_covariances[:-1] @ np.swapaxes(h_x, 1, 2)
    return observation(states), covariances


def widen_covariances(covariances: Array) -> Array:
    """Returns covariances (..., n, n) with LOWEST_STD added in each direction, so invertible."""
    return covariances + LOWEST_STD**2 * np.eye(covariances.shape[-1])
