# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The situations from which one policy learns: starts, commands, and disturbances of the robot.

Each has its own q(ζ), and all train one policy (section 5). Nothing tells the policy in which one
it is, but what it reads. The first one starts at the task's x_1, where policies are tried: one that
had learned only from starts on the way fell there.
"""

from dataclasses import dataclass, replace

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.settings import SearchSettings
from vgps_ros.tasks import Task
from vgps_ros.tasks.disturbance import Disturbance, check_push_ends
from vgps_ros.tasks.disturbed_task import UNDISTURBED, disturb_task, draw_disturbance


@dataclass(frozen=True, eq=False)
class Situation:
    """One of the situations.

    Attributes:
        initial_state: x_1, shape (n_x,).
        context: commands and clock of each planned step, shape (T, n_z).
        disturbance: what disturbs the robot, and is part of its dynamics.
    """

    initial_state: Array
    context: Array
    disturbance: Disturbance = UNDISTURBED

    @classmethod
    def at_start(cls, task: Task) -> "Situation":
        """Returns the situation in which a task begins."""
        return cls(task.initial_state, task.planned_context)

    def of(self, task: Task) -> Task:
        """Returns the task in this situation.

        Raises:
            InvalidInputError: the disturbance does not suit the robot.
        """
        here = disturb_task(task, self.disturbance)
        return replace(here.in_context(self.context), initial_state=self.initial_state)

    def is_same(self, other: "Situation") -> bool:
        """Returns whether another situation is this one."""
        pairs = ((self.initial_state, other.initial_state), (self.context, other.context))
        alike = all(np.array_equal(one, two) for one, two in pairs)
        return alike and self.disturbance == other.disturbance


def situations(
    task: Task, settings: SearchSettings, seed: int
) -> list[tuple[Situation, Trajectory | None]]:
    """Draws the situations; see the settings `situations`, `disturb` and `commands`.

    Returns:
        Each with the motion from which its first solve starts; None for the task's own.

    Raises:
        InvalidInputError: as `check_situations` does.
    """
    check_situations(task, settings, seed)
    starts = initial_states(task, settings, seed)
    return [_situation(task, settings, seed, i, start) for i, start in enumerate(starts)]


def check_situations(task: Task, settings: SearchSettings, seed: int) -> None:
    """Checks that situations can be drawn, without making any motion.

    Raises:
        InvalidInputError: a disturbance does not suit the robot, a push may not end within the
            horizon, or no situation can start later.
    """
    if settings.disturb.push:
        seconds = task.horizon * task.dynamics.time_step
        shorten = "disturb.push_before or disturb.push_duration"
        check_push_ends(
            settings.disturb, seconds, "the horizon", shorten, "lengthen the task's horizon"
        )
    if settings.disturb.start_before:
        _check_later_starts(task, settings.situations)
    rng = generator(seed, Stream.DISTURBANCES, 0)
    disturb_task(task, draw_disturbance(task, settings.disturb, rng))


def initial_states(task: Task, settings: SearchSettings, seed: int) -> list[Array]:
    """Returns x_1 of each situation: the task's, of which the others are draws around it."""
    rng = generator(seed, Stream.INITIAL_STATES)
    draws = rng.standard_normal((settings.situations, len(task.varied_state_std)))
    others = task.dynamics.space.add(task.initial_state, task.varied_state_std * draws)[1:]
    return [task.initial_state, *others]


def drawn_context(task: Task, settings: SearchSettings, rng: np.random.Generator) -> Array:
    """Draws commands and the clock's first phase, (T, n_z)."""
    phase, _, _ = rng.uniform(size=3)  # as many as ever, so that seeds mean the same
    commands = task.signals.draw(rng, settings.commands)
    return task.signals.constant_context(commands, task.planned_horizon, phase)


def _situation(
    task: Task, settings: SearchSettings, seed: int, i: int, start: Array
) -> tuple[Situation, Trajectory | None]:
    rng, rng_of_motion, rng_of_context = (
        generator(seed, stream, i)
        for stream in (Stream.DISTURBANCES, Stream.INITIAL_CONTROLS, Stream.COMMANDS)
    )
    disturbance = draw_disturbance(task, settings.disturb, rng)
    latest = settings.disturb.start_before if i else 0.0
    begun = round(latest * rng.uniform() / task.dynamics.time_step)
    motion = None
    if begun:  # on the way of the task's first motion, whose first steps are left out
        steps = begun + task.planned_horizon
        whole = task.begin(task, start, steps, rng_of_motion).trajectory
        motion = Trajectory(whole.states[begun:], whole.controls[begun:])
        start = motion.states[0]
    context = drawn_context(task, settings, rng_of_context) if i else task.planned_context
    return Situation(start, context, disturbance), motion


def _check_later_starts(task: Task, count: int) -> None:
    """Checks that some situation can start on the way of the first motion."""
    if not task.begin.goes_on:
        raise InvalidInputError(
            f"disturb.start_before is set, but the first motion of the task {task.name} follows no "
            "law that could go on for longer; leave it out."
        )
    if count == 1:
        raise InvalidInputError(
            "disturb.start_before is set, but the first situation starts where the task does, and "
            "there is no other one; set situations to 2 or more, or leave it out."
        )
