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
        deterministic_costs: cost without noise in each situation, shape (I,); inf where the
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
    tasks: Sequence[Task], policy: GaussianPolicy, rollouts: int, seed: int, iteration: int
) -> Evaluation:
    """Rolls a policy out in each situation.

    Args:
        tasks: the task in each; stochastic rollouts start from draws around its x_1.
        policy: π_θ.
        rollouts: number of stochastic rollouts in each situation.
        seed: seed of the run.
        iteration: k, the place of these draws in the run.
    """
    task = tasks[0]
    rng, space = generator(seed, Stream.EVALUATION, iteration), task.dynamics.space
    spread = task.initial_std * rng.standard_normal((len(tasks) * rollouts, space.tangent_dim))
    noise = rng.standard_normal((task.horizon, len(spread), len(policy.noise_std)))
    noise = np.ascontiguousarray(np.swapaxes(policy.noise_std * noise, 0, 1))
    without = np.zeros_like(noise[:1])  # the first rollout in each situation has no noise
    costs, survived = [], []
    for i, here in enumerate(tasks):
        own = slice(i * rollouts, (i + 1) * rollouts)
        draws = np.concatenate([np.zeros_like(spread[:1]), spread[own]])
        starts = space.add(here.initial_state, draws)
        starts[0] = here.initial_state
        drawn = np.concatenate([without, noise[own]])
        states, controls = here.dynamics.execute(policy, here.observation, starts, drawn)
        costs.append(here.rollout_costs(states, controls))
        survived.append(here.survived(states))
    return Evaluation(
        deterministic_costs=np.array([each[0] for each in costs]),
        stochastic_costs=np.concatenate([each[1:] for each in costs]),
        deterministic_survived=np.array([each[0] for each in survived]),
        stochastic_survived=np.concatenate([each[1:] for each in survived]),
    )
