# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Rollouts from draws around a task's start, over the horizon that is scored."""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.dynamics import ControlLaw
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
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
    starts = _starts(task, rng.standard_normal((count, dynamics.space.tangent_dim)))
    drawn = np.full((task.horizon, count, dynamics.control_dim), np.nan)

    def noted(t: int, x: Array) -> Array:
        drawn[t] = law(t, x)
        return drawn[t]

    states, controls, steps = dynamics.rollouts(starts, noted, task.horizon)
    return _score(task, states, controls, np.ascontiguousarray(drawn.swapaxes(0, 1))), steps


@dataclass(frozen=True)
class Execution:
    """A policy's rollouts with its noise."""

    task: Task  # in its situation
    policy: GaussianPolicy  # π_θ
    noise: Array  # what was added to its mean, shape (N, T, n_u)
    states: Array  # x_1 … x_{T+1}, shape (N, T+1, n_x), NaN from where a rollout has diverged
    controls: Array  # as applied, shape (N, T, n_u)

    def first(self, count: int) -> "Execution":
        """Returns the first rollouts."""
        parts = self.noise[:count], self.states[:count], self.controls[:count]
        return Execution(self.task, self.policy, *parts)

    @property
    def steps(self) -> int:
        """Number of simulator steps."""
        sound = np.isfinite(self.states[:, :-1]).all(axis=2).sum()
        return int(sound) * self.task.dynamics.substeps

    def scored(self) -> Rollouts:
        """Returns what was drawn, and what it cost; see `roll_out`."""
        executed = np.nan_to_num(self.states[:, :-1]), np.nan_to_num(self.controls)
        drawn = self.policy.mean(self.task.observation.along(*executed)) + self.noise
        return _score(self.task, self.states, self.controls, drawn)


class Executions:
    """Executes policies with their noise.

    The policy of an iteration is judged by the rollouts from which the next one learns. So the last
    rollouts in each situation are kept; whether they were changes no bit.

    Args:
        seed: seed of all random draws.
    """

    def __init__(self, seed: int):
        self._seed = seed
        self._kept: dict[tuple[int, int], Execution] = {}

    def of(self, task: Task, policy: GaussianPolicy, count: int, k: int, i: int) -> Execution:
        """Returns rollouts in situation i, from which iteration k learns; they begin alike."""
        self._kept = {place: kept for place, kept in self._kept.items() if place[0] == k}
        known = self._kept.get((k, i))
        if known is None or known.task is not task or known.policy is not policy:
            known = self._executed(task, policy, 0, count, k, i)
        elif len(known.noise) < count:
            more = self._executed(task, policy, len(known.noise), count, k, i)
            parts = ((getattr(e, name) for e in (known, more)) for name in _PARTS)
            known = Execution(task, policy, *(np.concatenate(list(pair)) for pair in parts))
        self._kept[k, i] = known
        return known.first(count)

    def _executed(
        self, task: Task, policy: GaussianPolicy, first: int, count: int, k: int, i: int
    ) -> Execution:
        rng, dynamics = generator(self._seed, Stream.POLICY_ROLLOUTS, k, i), task.dynamics
        n_dx, shape = dynamics.space.tangent_dim, (task.horizon, dynamics.control_dim)
        drawn = rng.standard_normal((count, n_dx + np.prod(shape)))[first:]
        starts = _starts(task, drawn[:, :n_dx])
        noise = policy.noise_std * drawn[:, n_dx:].reshape(-1, *shape)
        motions = dynamics.execute(policy, task.observation, starts, noise)
        return Execution(task, policy, noise, *motions)


_PARTS = "noise", "states", "controls"


def _score(task: Task, states: Array, controls: Array, drawn: Array) -> Rollouts:
    """Adds the costs to states (N, T+1, n_x), controls as applied and as drawn, (N, T, n_u)."""
    lies = np.logical_or.accumulate(task.fallen(states[:, :-1]), axis=1)
    costs = np.where(lies, task.cost.rest(task.horizon), task.cost(states[:, :-1], controls))
    # A rollout that diverges in its last step has no cost either.
    costs[~np.isfinite(states[:, -1]).all(axis=1), -1] = np.nan
    return Rollouts(states[:, :-1], drawn, costs)


def _starts(task: Task, drawn: Array) -> Array:
    """Returns states around the task's start, (N, n_x), for standard draws (N, n_dx)."""
    return task.dynamics.space.add(task.initial_state, task.initial_std * drawn)
