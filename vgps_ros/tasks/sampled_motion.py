# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A first motion found by sampling, without a demonstration: `begin: {law: sampling}`.

Samples find what derivatives do not see, such as a leap from a crouch; a few iterations of DDP on
each short plan then take the noise out of it. MuJoCo MPC has the same mixture as a planner, iLQS.
A sample adds a random spline to the plan,

    u_i = clip(ū + W ε_i),    ε_i ~ N(0, σ²) at each knot,

where W interpolates between knots, and no sample of a set is the plan itself but the first. By
predictive sampling (Howell et al., arXiv 2212.00541) the best sample is the next plan. By the
cross-entropy method (Kobilarov, IJRR 2012) the mean of the elites is, and their spread is the σ of
the next set.

A long horizon is filled with the first pieces of short plans: at each replanning the last plan,
shifted by what was executed of it, is improved by samples from the state that was reached, and
refined by DDP; its first controls are executed, and the next plan starts where they lead.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.slow_steps import progress_lines
from vgps_ros.tasks.task import Nominal, Task

METHODS = ("predictive", "cross_entropy")
# The samples' standard deviations reach from σ down to this share of it, since a rough search finds
# new motions and a fine one finishes them.
_FINEST = 0.1

PlanCost = Callable[[Array], Array]
"""Maps plans (N, H, n_u) to their costs (N,); inf for one that diverges."""


@dataclass(frozen=True)
class Sampler:
    """Samples plans around a plan, and keeps what is better.

    Attributes:
        method: one of METHODS.
        steps: H, the number of controls of a plan.
        knots: number of knots of the random splines, at least 2.
        samples: number of samples of a set, the plan itself included.
        iterations: number of sets, one after another.
        elites: number of samples that the cross-entropy method fits.
        std: σ of each control, shape (n_u,).
        low: smallest value of each control, shape (n_u,).
        high: largest value of each.
    """

    method: str
    steps: int
    knots: int
    samples: int
    iterations: int
    elites: int
    std: Array
    low: Array
    high: Array

    def improved(
        self, plan: Array, cost: PlanCost, rng: np.random.Generator
    ) -> tuple[Array, float]:
        """Returns a plan that costs no more than the one given, shape (H, n_u), and its cost."""
        spline = interpolation(self.steps, self.knots)
        std: Any = self.std * np.geomspace(1.0, _FINEST, self.samples)[:, None, None]
        best, least = plan, np.inf
        for _ in range(self.iterations):
            noise = rng.standard_normal((self.samples, self.knots, len(self.std))) * std
            noise[0] = 0.0
            plans = np.clip(plan + spline @ noise, self.low, self.high)
            costs = cost(plans)
            order = np.argsort(costs, kind="stable")
            if costs[order[0]] < least:
                best, least = plans[order[0]], float(costs[order[0]])
            if self.method == "predictive":
                plan = best
                continue
            elites = order[: self.elites]
            plan = plans[elites].mean(axis=0)
            std = np.maximum(noise[elites].std(axis=0), _FINEST * self.std)
        return best, least


def interpolation(steps: int, knots: int) -> Array:
    """Returns W, which maps values at equally spaced knots to all steps, shape (steps, knots)."""
    at = np.linspace(0.0, knots - 1.0, steps)
    return np.maximum(1.0 - np.abs(at[:, None] - np.arange(knots)), 0.0)


FALLEN = 1e6  # cost of a step in which the robot lies: a plan that falls later is better


@dataclass(frozen=True)
class Plans:
    """The task as the problem of which a plan is a part."""

    task: Task
    ddp_iterations: int

    def simulate(self, start: Array, plans: Array) -> Array:
        """Returns states (N, H+1, n_x) of plans (N, H, n_u); NaN after one has diverged."""
        return self.task.dynamics.replay(start, plans)

    def score(self, states: Array, plans: Array, first: int) -> Array:
        """Returns the cost of each plan, shape (N,); `first` is the place of its first step."""
        costs = self.task.cost(states[:, :-1], plans, first).sum(axis=1)
        costs += FALLEN * self.task.fallen(states[:, 1:]).sum(axis=1)
        return np.where(np.isfinite(states).all(axis=(1, 2)), costs, np.inf)

    def refine(self, motion: Trajectory, first: int) -> Array:
        """Returns controls (H, n_u) that DDP finds; a motion's own where it makes that diverge."""
        if self.ddp_iterations == 0:
            return motion.controls
        cost = self.task.cost.starting_at(first, motion.horizon)
        settings = self.task.optimizer.ddp
        try:
            found = solve(self.task.dynamics, cost, motion, settings, self.ddp_iterations)
        except DivergenceError:
            return motion.controls
        return found.trajectory.controls


def receding_motion(
    problem: Plans,
    sampler: Sampler,
    start: Array,
    horizon: int,
    period: int,
    rng: np.random.Generator,
    *,
    on_progress: Callable[[float], None] = lambda _: None,
    is_cancelled: Callable[[], bool] = lambda: False,
) -> Trajectory:
    """Returns the motion that replanning makes.

    Args:
        problem: the problem.
        sampler: improves each plan.
        start: x_1, shape (n_x,).
        horizon: T, the number of controls to execute.
        period: number of controls that are executed of each plan, at most the plan's length.
        rng: source of the samples.
        on_progress: called after each piece with the share of the horizon that is filled.
        is_cancelled: asked before each replanning; once it is true, no plan is improved any more.
    """
    plan = np.clip(np.zeros((sampler.steps, len(sampler.std))), sampler.low, sampler.high)
    states, controls = [start[None]], []
    for first in range(0, horizon, period):
        if not is_cancelled():
            plan = replanned(problem, sampler, plan, states[-1][-1], first, rng)
        piece = plan[: min(period, horizon - first)]
        states.append(problem.simulate(states[-1][-1], piece[None])[0, 1:])
        controls.append(piece)
        plan = np.concatenate([plan[period:], np.repeat(plan[-1:], period, axis=0)])
        on_progress((first + len(piece)) / horizon)
    return Trajectory(np.concatenate(states), np.concatenate(controls))


def replanned(
    problem: Plans,
    sampler: Sampler,
    plan: Array,
    x: Array,
    first: int,
    rng: np.random.Generator,
) -> Array:
    """Returns controls (H, n_u) that cost no more than a plan's.

    Args:
        problem: the problem.
        sampler: improves the plan.
        plan: its controls, shape (H, n_u).
        x: the state in which it begins, shape (n_x,).
        first: place of its first step.
        rng: source of the samples.
    """

    def cost(plans: Array) -> Array:
        return problem.score(problem.simulate(x, plans), plans, first)

    plan, least = sampler.improved(plan, cost, rng)
    motion = Trajectory(problem.simulate(x, plan[None])[0], plan)
    if not np.isfinite(motion.states).all():
        return plan
    refined = problem.refine(motion, first)
    return refined if cost(refined[None])[0] < least else plan


@dataclass(frozen=True)
class SampledMotion:
    """Finds the first motion of a task.

    Attributes:
        sampler: improves each plan.
        period: number of controls after which the next plan is made.
        ddp_iterations: iterations of DDP on each plan.
    """

    sampler: Sampler
    period: int
    ddp_iterations: int
    goes_on: ClassVar[bool] = True

    def __call__(
        self,
        task: Task,
        start: Array,
        steps: int,
        rng: np.random.Generator,
        is_cancelled: Callable[[], bool] = lambda: False,
        /,
    ) -> Nominal:
        """Returns the motion, whose simulator steps do not count as learning."""
        motion = receding_motion(
            Plans(task, self.ddp_iterations),
            self.sampler,
            start,
            steps,
            self.period,
            rng,
            on_progress=progress_lines(f"Samples a first motion of {task.name}"),
            is_cancelled=is_cancelled,
        )
        return Nominal(motion)
