# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A first motion found by sampling, without a demonstration: `begin: {law: sampling}`.

Samples find what derivatives do not see, such as a leap from a crouch; a few iterations of DDP on
each short plan then take the noise out of it. MuJoCo MPC has the same mixture as a planner, iLQS.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.sampling.planner import Sampler
from vgps_ros.core.sampling.receding_motion import receding_motion
from vgps_ros.core.slow_steps import progress_lines
from vgps_ros.tasks.task import Task
from vgps_ros.tasks.task_schema import Sampling
from vgps_ros.tasks.yaml_document import Document

FALLEN = 1e6  # cost of a step in which the robot lies: a plan that falls later is better


@dataclass(frozen=True)
class Plans:
    """The task as a `PlanProblem`, which describes the methods."""

    task: Task
    ddp_iterations: int

    def simulate(self, start: Array, plans: Array) -> Array:
        """Runs plans on the task's dynamics."""
        return self.task.dynamics.replay(start, plans)

    def score(self, states: Array, plans: Array, first: int) -> Array:
        """Scores plans by the task's cost, and each step in which the robot lies by `FALLEN`."""
        costs = self.task.cost(states[:, :-1], plans, first).sum(axis=1)
        costs += FALLEN * self.task.fallen(states[:, 1:]).sum(axis=1)
        return np.where(np.isfinite(states).all(axis=(1, 2)), costs, np.inf)

    def refine(self, motion: Trajectory, first: int) -> Array:
        """Refines a motion by DDP; one that it makes diverge is left as it is."""
        if self.ddp_iterations == 0:
            return motion.controls
        cost = self.task.cost.starting_at(first, motion.horizon)
        settings = self.task.optimizer.ddp
        try:
            found = solve(self.task.dynamics, cost, motion, settings, self.ddp_iterations)
        except DivergenceError:
            return motion.controls
        return found.trajectory.controls


@dataclass(frozen=True)
class SampledBeginning:
    """Finds the first motion of a task.

    Attributes:
        task: the task.
        sampler: improves each plan.
        period: number of controls after which the next plan is made.
        ddp_iterations: iterations of DDP on each plan.
    """

    task: Task
    sampler: Sampler
    period: int
    ddp_iterations: int

    def __call__(
        self,
        start: Array,
        steps: int,
        rng: np.random.Generator,
        is_cancelled: Callable[[], bool] = lambda: False,
        /,
    ) -> Trajectory:
        """Returns the motion; see `Demonstrate`."""
        return receding_motion(
            Plans(self.task, self.ddp_iterations),
            self.sampler,
            start,
            steps,
            self.period,
            rng,
            on_progress=progress_lines(f"Samples a first motion of {self.task.name}"),
            is_cancelled=is_cancelled,
        )


def sampled_beginning(task: Task, begin: Sampling, document: Document) -> SampledBeginning:
    """Returns what finds the first motion.

    Raises:
        InvalidInputError: a time is shorter than a control, elites are more than samples, or a
            control has no range and no standard deviation.
    """
    step = task.dynamics.time_step
    for key, time in (("plan", begin.plan), ("period", begin.period)):
        document.refuse(
            time < step,
            ("begin", key),
            f"it is {time:g} s, but it must be at least the control_period, {step:g} s.",
        )
    document.refuse(
        begin.period > begin.plan,
        ("begin", "period"),
        f"it is {begin.period:g} s, but a plan of {begin.plan:g} s has no more to execute.",
    )
    document.refuse(
        begin.elites > begin.samples,
        ("begin", "elites"),
        f"it is {begin.elites}, but only {begin.samples} samples are drawn.",
    )
    low, high = task.dynamics.control_limits
    return SampledBeginning(
        task,
        Sampler(
            method=begin.method,
            steps=round(begin.plan / step),
            knots=begin.knots,
            samples=begin.samples,
            iterations=begin.iterations,
            elites=begin.elites,
            std=_std(begin, low, high, document),
            low=low,
            high=high,
        ),
        round(begin.period / step),
        begin.ddp_iterations,
    )


def _std(begin: Sampling, low: Array, high: Array, document: Document) -> Array:
    """Returns the standard deviation of each control's samples, shape (n_u,)."""
    if begin.std is None:
        document.refuse(
            bool(np.isinf(high - low).any()),
            ("begin",),
            "a control of the model has no range; give `std`, the standard deviation of the "
            "samples [N·m], or a ctrlrange (changes: actuators: limit).",
        )
        return np.asarray(begin.noise * (high - low) / 2)
    std = np.array(begin.std)
    document.refuse(
        std.size not in (1, low.size),
        ("begin", "std"),
        f"it has {std.size} values, but the model has {low.size} actuators.",
    )
    document.refuse(
        ("begin", "noise") in document.lines,
        ("begin", "noise"),
        "it is a share of the controls' range, for which std stands; leave one of them out.",
    )
    return np.broadcast_to(std, low.shape).astype(float)
