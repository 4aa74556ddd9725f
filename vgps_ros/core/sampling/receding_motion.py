# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Fills a long horizon with the first pieces of short plans.

At each replanning the last plan, shifted by what was executed of it, is improved by samples from
the state that was reached, and refined where a refinement is given; its first controls are
executed, and the next plan starts where they lead.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.sampling.planner import Sampler


class PlanProblem(Protocol):
    """The problem of which a plan is a part."""

    def simulate(self, start: Array, plans: Array) -> Array:
        """Returns states (N, H+1, n_x) of plans (N, H, n_u); NaN after one has diverged."""

    def score(self, states: Array, plans: Array, first: int) -> Array:
        """Returns the cost of each plan, shape (N,); `first` is the place of its first step."""

    def refine(self, motion: Trajectory, first: int) -> Array:
        """Returns controls (H, n_u), within their limits, to try instead of a motion's."""


def receding_motion(
    problem: PlanProblem,
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
    problem: PlanProblem,
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
