# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A first motion found by sampling, without a demonstration: `begin: {law: sampling}`.

Samples find what derivatives do not see, such as a leap from a crouch; a few iterations of DDP on
each short plan then take the noise out of it. MuJoCo MPC has the same mixture as a planner, iLQS.
A sample adds a random spline to the plan,

    u_i = clip(ū + W ε_i),    ε_i ~ N(0, σ²) at each knot,

where W interpolates between knots, and no sample of a set is the plan itself but the first. The
best sample is the next plan: predictive sampling (Howell et al., arXiv 2212.00541).

A long horizon is filled with the first pieces of short plans: at each replanning the last plan,
shifted by what was executed of it, is improved by samples from the state that was reached, and
refined by DDP; its first controls are executed, and the next plan starts where they lead.

What swings up or catches gets nowhere for seconds, so short plans see nothing. An `Arrival` samples
the whole motion at once, as if the robot could stay where it arrives.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.slow_steps import progress_lines
from vgps_ros.tasks.task import Nominal, Task

# The samples' standard deviations reach from σ down to this share of it, since a rough search finds
# new motions and a fine one finishes them.
_FINEST = 0.1

PlanCost = Callable[[Array], Array]
"""Maps plans (N, H, n_u) to their costs (N,); inf for one that diverges."""


@dataclass(frozen=True)
class Sampler:
    """Samples plans around a plan, and keeps what is better.

    Attributes:
        steps: H, the number of controls of a plan.
        knots: number of knots of the random splines, at least 2.
        samples: number of samples of a set, the plan itself included.
        iterations: number of sets, one after another.
        std: σ of each control, shape (n_u,).
        low: smallest value of each control, shape (n_u,).
        high: largest value of each.
    """

    steps: int
    knots: int
    samples: int
    iterations: int
    std: Array
    low: Array
    high: Array

    def improved(
        self, plan: Array, cost: PlanCost, rng: np.random.Generator
    ) -> tuple[Array, float]:
        """Returns a plan that costs no more than the one given, shape (H, n_u), and its cost."""
        spline = interpolation(self.steps, self.knots)
        std = self.std * np.geomspace(1.0, _FINEST, self.samples)[:, None, None]
        best, least = plan, np.inf
        for _ in range(self.iterations):
            noise = rng.standard_normal((self.samples, self.knots, len(self.std))) * std
            noise[0] = 0.0
            plans = np.clip(plan + spline @ noise, self.low, self.high)
            costs = cost(plans)
            first = np.argsort(costs, kind="stable")[0]
            if costs[first] < least:
                best, least = plans[first], float(costs[first])
            plan = best
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

    def steps(self, states: Array, plans: Array, first: int) -> Array:
        """Returns the cost of each step (N, H), inf in one that diverges; `first` is its place."""
        costs = self.task.cost(states[:, :-1], plans, first)
        costs = costs + FALLEN * self.task.fallen(states[:, 1:])
        sound = np.reshape(np.isfinite(states).all(axis=(1, 2)), (-1, 1))
        return np.where(sound, costs, np.inf)

    def score(self, states: Array, plans: Array, first: int) -> Array:
        """Returns the cost of each plan, shape (N,)."""
        return np.asarray(self.steps(states, plans, first).sum(axis=1))

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
            plan = replan(problem, sampler, plan, states[-1][-1], first, rng)
        piece = plan[: min(period, horizon - first)]
        states.append(problem.simulate(states[-1][-1], piece[None])[0, 1:])
        controls.append(piece)
        plan = np.concatenate([plan[period:], np.repeat(plan[-1:], period, axis=0)])
        on_progress((first + len(piece)) / horizon)
    return Trajectory(np.concatenate(states), np.concatenate(controls))


def replan(
    problem: Plans, sampler: Sampler, plan: Array, x: Array, first: int, rng: np.random.Generator
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


@dataclass(frozen=True)
class Arrival:
    """A motion that arrives somewhere, and that is then at rest there.

    A sampled plan costs what its steps cost until it arrives, and from then on what the w steps
    after that cost on average:

        J = min_k Σ_{t<k} c_t + (T − k)/w Σ_{k≤t<k+w} c_t.

    So early arrivals are found before staying is. From the best of those w steps on the motion is
    the state there, at rest, which need not be feasible: the solve closes the gaps. Where w is
    short, a robot may pass through a goal at which it cannot stop; where w is long, a plan must
    hold what falls.

    Attributes:
        window: w, as a time [s].
        seed: of the samples, so that several may differ.
        spacing: time between the knots of a random spline [s].
        samples: number of samples of a set.
        iterations: number of sets.
    """

    window: float
    seed: int
    spacing: float = 0.3
    samples: int = 64
    iterations: int = 20
    goes_on: ClassVar[bool] = False

    def __call__(
        self, task: Task, start: Array, steps: int, rng: np.random.Generator, *_: Any
    ) -> Nominal:
        """Returns the motion, whose simulator steps do not count as learning."""
        low, high = task.dynamics.control_limits
        period, plans = task.dynamics.time_step, Plans(task, 0)
        sampler = Sampler(
            steps=steps,
            knots=max(2, round(steps * period / self.spacing)),
            samples=self.samples,
            iterations=self.iterations,
            std=half_ranges(low, high),
            low=low,
            high=high,
        )
        width = min(steps, max(1, round(self.window / period)))

        def costs(controls: Array) -> Array:
            """Returns Σ_{t<k} c_t + (T − k)/w Σ c_t for each k, shape (N, T − w + 1)."""
            each = plans.steps(plans.simulate(start, controls), controls, 0)
            means = sliding_window_view(each, width, axis=1).mean(axis=2)
            before = (np.cumsum(each, axis=1) - each)[:, : means.shape[1]]
            return before + means * (steps - np.arange(means.shape[1]))

        none = np.clip(np.zeros((steps, len(low))), low, high)
        rng = np.random.default_rng(self.seed)
        found = sampler.improved(none, lambda tried: costs(tried).min(axis=1), rng)[0]
        states = plans.simulate(start, found[None])[0]
        first = int(costs(found[None])[0].argmin())
        each = plans.steps(states[None], found[None], 0)[0]
        arrived = first + int(each[first : first + width].argmin())
        stays = states[arrived].copy()
        stays[task.dynamics.model.nq :] = 0.0
        rests = steps - arrived
        rest = np.tile(task.dynamics.controls.resting(stays), (rests, 1))
        motion = Trajectory(
            np.concatenate([states[: arrived + 1], np.tile(stays, (rests, 1))]),
            np.concatenate([found[:arrived], rest]),
        )
        return Nominal.guessed(motion, task.dynamics)


def half_ranges(low: Array, high: Array) -> Array:
    """Returns half of each control's range; 1 where it has none."""
    return 0.5 * np.where(np.isfinite(high - low), high - low, 2.0)
