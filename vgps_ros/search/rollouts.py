# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Rollouts on the true dynamics that a method learns from."""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.checks import check_array
from vgps_ros.core.dynamics import ControlLaw
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class Rollouts:
    """Rollouts over the scored horizon, in one situation.

    Attributes:
        states: x_1 … x_T, shape (N, T, n_x), NaN where a rollout has diverged.
        controls: what was drawn, shape (N, T, n_u), [N·m]. The robot applies it within its limits.
        costs: c(x_t, u_t) of what was applied, shape (N, T).
    """

    states: Array
    controls: Array
    costs: Array

    def check(self, task: Task) -> None:
        """Checks that sound rollouts fit the task.

        Raises:
            InvalidInputError: an array does not fit the task, or is not finite.
        """
        count, dims = len(self.states), task.dims
        check_array("states", self.states, (count, task.horizon, dims["n_x"]))
        check_array("controls", self.controls, (count, task.horizon, dims["n_u"]))
        check_array("costs", self.costs, (count, task.horizon))

    def sound(self) -> "Rollouts":
        """Returns the rollouts that did not diverge."""
        kept = np.isfinite(self.costs).all(axis=1)
        return Rollouts(self.states[kept], self.controls[kept], self.costs[kept])


def roll_out(
    task: Task, count: int, rng: np.random.Generator, law: ControlLaw
) -> tuple[Rollouts, int]:
    """Executes a control law from draws around the task's start, until it is scored.

    A robot's motion after its fall is not scored: each step then costs as much as lying still.
    Also returns the number of simulator steps.
    """
    dynamics = task.dynamics
    starts = _starts(task, count, rng)
    drawn = np.full((task.horizon, count, dynamics.control_dim), np.nan)

    def noted(t: int, x: Array) -> Array:
        drawn[t] = law(t, x)
        return drawn[t]

    states, controls, steps = dynamics.rollouts(starts, noted, task.horizon)
    return _scored(task, states, controls, np.ascontiguousarray(drawn.swapaxes(0, 1))), steps


def roll_out_policy(
    task: Task, policy: GaussianPolicy, count: int, rng: np.random.Generator
) -> tuple[Rollouts, int]:
    """Executes a policy with its noise, as `roll_out` does, but compiled."""
    starts, dynamics = _starts(task, count, rng), task.dynamics
    noise = policy.noise_std * rng.standard_normal((count, task.horizon, len(policy.noise_std)))
    states, controls = dynamics.execute(policy, task.observation, starts, noise)
    drawn = policy.mean(task.observation(np.nan_to_num(states[:, :-1]))) + noise
    steps = int(np.isfinite(states[:, :-1]).all(axis=2).sum()) * dynamics.substeps
    return _scored(task, states, controls, drawn), steps


def _scored(task: Task, states: Array, controls: Array, drawn: Array) -> Rollouts:
    """Adds the costs to states (N, T+1, n_x), controls as applied and as drawn, (N, T, n_u)."""
    lies = np.logical_or.accumulate(task.fallen(states[:, :-1]), axis=1)
    costs = np.where(lies, task.cost.rest(task.horizon), task.cost(states[:, :-1], controls))
    # A rollout that diverges in its last step has no cost either.
    costs[~np.isfinite(states[:, -1]).all(axis=1), -1] = np.nan
    return Rollouts(states[:, :-1], drawn, costs)


def _starts(task: Task, count: int, rng: np.random.Generator) -> Array:
    """Draws states around the task's start, shape (N, n_x)."""
    space = task.dynamics.space
    spread = task.initial_std * rng.standard_normal((count, space.tangent_dim))
    return space.add(task.initial_state, spread)
