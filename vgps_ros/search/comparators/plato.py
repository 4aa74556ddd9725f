# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""PLATO (Kahn, Zhang, Levine and Abbeel, ICRA 2017): model predictive control teaches the policy.

    u = ū_t + K_t (x ⊖ x̄_t) + ε                       drives, along plans of c − w log π_θ
    θ ← argmax Σ_(x,t) in D  log π_θ(ū_t + K_t (x ⊖ x̄_t) | x)

A DDP solution knows what to do near one motion. Plans begin where the robot is, so this teacher has
an answer to any start and any disturbance, though it does not know the disturbance. The teacher
drives, where DAGGER lets the policy drive, so that a policy which is still poor does not fill the
dataset with falls; the cost of its plans draws it towards what the policy would do. Its noise ε
brings it into the states around its motion, where it shows how to come back, as in DART (Laskey et
al., CoRL 2017): like guiding rollouts of GPS it has a share of π_G's noise.

Choices: the targets are the actions of the plans that drive, where PLATO makes further plans for
them, without the policy's cost; that takes half as many. A plan serves several control steps, by
its gains, and may begin with the DDP solution as well as with the plan before it. A rollout teaches
until its robot falls or it has no plan left. The simulator steps of the plans are not counted.
"""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from vgps_ros.core.ddp.solve import Status
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_fit import Targets
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.mpc import MpcSettings, Plan, Planner
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.workspace import Update, Workspace
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class Lessons(Update):
    """The result of one iteration.

    Attributes:
        states: states of the dataset, shape (N, n_x).
        actions: what the teacher did in them, but for its noise, shape (N, n_u), [N·m].
    """

    states: Array
    actions: Array


class Teacher:
    """Drives several rollouts of one situation side by side, each with its own plans.

    Attributes:
        actions: what the plans did, without noise, shape (N, T, n_u); NaN where there was no plan.

    Args:
        planner: makes the plans.
        every: control steps between two plans.
        policy: π_θ, to which the plans keep.
        q: the initial solution, which is the first plan of each rollout, and with which each
            later one may begin.
        noise: ε, shape (N, T, n_u), [N·m].
    """

    def __init__(
        self,
        planner: Planner,
        every: int,
        policy: GaussianPolicy,
        q: TrajectoryDistribution,
        noise: Array,
    ):
        self._planner, self._every, self._policy, self._noise = planner, every, policy, noise
        self.actions = np.full_like(noise, np.nan)
        self._first = Plan(0, q.mean, q.gains, np.inf, Status.CONVERGED)
        self._plans = [self._first] * len(noise)

    def __call__(self, t: int, states: Array) -> Array:
        """Returns controls in states (N, n_x), shape (N, n_u); zeros where there is no plan."""
        for i, state in enumerate(states):
            if t % self._every == 0:
                self._plan(i, state, t)
            if t < self._plans[i].start + len(self._plans[i].gains):
                self.actions[i, t] = self._planner.control(self._plans[i], state, t)
        return np.nan_to_num(self.actions[:, t]) + self._noise[:, t]

    def _plan(self, i: int, state: Array, t: int) -> None:
        """Makes a rollout's next plan; the old one goes on where none is found."""
        old, known = self._plans[i], (self._first,)
        with suppress(DivergenceError):
            self._plans[i] = self._planner.next_plan(old, state, t, self._policy, known=known)


def plato(work: Workspace, last: Lessons | None, k: int) -> Lessons:
    """Does iteration k: a copy of the DDP solution first, then lessons and a fit to all of them."""
    scored, observation = work.taught(work.initial_solutions), work.task.observation
    if last is None:
        dims = work.task.dims
        none = np.empty((0, dims["n_x"])), np.empty((0, dims["n_u"]))
        return Lessons(work.supervised_policy(), work.initial_solutions, *none)
    planner = _planner(work)
    lessons = [_lesson(work, planner, i, q, last.policy, k) for i, q in enumerate(scored)]
    states, actions = (
        np.concatenate([old, *new])
        for old, *new in zip((last.states, last.actions), *lessons, strict=True)
    )
    targets = Targets(observation(states), actions, np.zeros_like(actions))
    policy = work.fit_samples(last.policy, targets, None, k)
    return Lessons(policy, last.solutions, states, actions)


def check_teacher(task: Task, settings: SearchSettings) -> None:
    """Checks that a plan of the teacher has a step, and that it knows all that the policy reads.

    Raises:
        InvalidInputError: its horizon is too short, or the task has commands or a clock.
    """
    if task.signals.names:
        raise InvalidInputError(
            f"The method plato teaches motions, but the task {task.name} has "
            f"{', '.join(task.signals.names)}; use vgps."
        )
    horizon, period = settings.teacher.horizon, task.dynamics.time_step
    if round(horizon / period) < 1:
        raise InvalidInputError(
            f"teacher.horizon is {horizon:g} s, but a plan of the {task.name} must have at least "
            f"one control period, {period:g} s."
        )


def _planner(work: Workspace) -> Planner:
    """Returns what makes the plans, which are no longer than the task's horizon."""
    task, own = work.task, work.settings.teacher
    horizon = min(own.horizon, task.horizon * task.dynamics.time_step)
    return Planner(task, MpcSettings(horizon, ddp=task.optimizer.ddp))


def _lesson(
    work: Workspace,
    planner: Planner,
    i: int,
    q: TrajectoryDistribution,
    policy: GaussianPolicy,
    k: int,
) -> tuple[Array, Array]:
    """Returns states and the teacher's actions in rollouts of situation i, (N, n_x), (N, n_u)."""
    settings, here = work.settings, work.tasks[i]
    rng, count = generator(work.seed, Stream.POLICY_ROLLOUTS, k, i), settings.policy_rollouts
    std = np.sqrt(np.diagonal(q.control_covariances, axis1=1, axis2=2).mean(axis=0))
    draws = rng.standard_normal((count, here.horizon, len(std)))
    noise = settings.teacher.noise * std * draws
    teacher = Teacher(planner, settings.teacher.plan_every, policy, q, noise)
    rollouts = work.roll_out(i, count, rng, teacher)
    finite = np.isfinite(rollouts.states).all(axis=2)
    fallen = here.fallen(np.nan_to_num(rollouts.states))
    taught = finite & ~fallen & np.isfinite(teacher.actions).all(axis=2)
    kept = np.logical_and.accumulate(taught, axis=1)
    return rollouts.states[kept], teacher.actions[kept]
