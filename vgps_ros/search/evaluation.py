# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The two costs that Figure 1 of the paper plots, on the true dynamics."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class Evaluation:
    """Costs of a policy.

    Attributes:
        deterministic_costs: cost without noise from each initial state, shape (I,); inf where the
            rollout diverged.
        stochastic_costs: cost of each stochastic rollout, shape (N,); inf where it diverged.
        deterministic_survived: whether each deterministic rollout neither diverged nor fell, (I,).
        stochastic_survived: the same for the stochastic rollouts, shape (N,).
    """

    deterministic_costs: Array
    stochastic_costs: Array
    deterministic_survived: NDArray[np.bool_]
    stochastic_survived: NDArray[np.bool_]


def evaluate(
    task: Task,
    policy: GaussianPolicy,
    initial_states: Sequence[Array],
    rollouts: int,
    seed: int,
    iteration: int,
) -> Evaluation:
    """Rolls a policy out from each initial state.

    Args:
        task: dynamics, cost and horizon.
        policy: π_θ.
        initial_states: means of x_1; stochastic rollouts start from draws around them.
        rollouts: number of stochastic rollouts from each initial state.
        seed: seed of the run.
        iteration: k, the place of these draws in the run.
    """
    means = np.stack(initial_states)
    deterministic = slice(0, len(means))  # the first rollouts have no noise
    stochastic = slice(len(means), None)
    starts = np.concatenate([means, np.repeat(means, rollouts, axis=0)])
    noise = np.zeros((len(starts), task.horizon, len(policy.noise_std)))
    rng = generator(seed, Stream.EVALUATION, iteration)
    space = task.dynamics.space
    spread = rng.standard_normal((len(starts) - len(means), space.tangent_dim))
    starts[stochastic] = space.add(starts[stochastic], task.initial_std * spread)
    draws = rng.standard_normal((task.horizon, len(spread), len(policy.noise_std)))
    noise[stochastic] = policy.noise_std * np.swapaxes(draws, 0, 1)

    states, controls = task.dynamics.execute(policy, task.observation, starts, noise)
    costs, survived = task.rollout_costs(states, controls), task.survived(states)
    return Evaluation(
        deterministic_costs=costs[deterministic],
        stochastic_costs=costs[stochastic],
        deterministic_survived=survived[deterministic],
        stochastic_survived=survived[stochastic],
    )
