# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The situations from which one policy learns: starts, and disturbances of the robot.

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
from vgps_ros.tasks.disturbed_task import disturbed, draw_disturbance


@dataclass(frozen=True)
class Situation:
    """One of the situations.

    Attributes:
        task: the task in it: with its x_1, and under its disturbance.
        disturbance: what disturbs the robot.
        guess: controls (T, n_u) from which its first solve starts; None: the task's own motion.
        guess_states: states (T+1, n_x) that go with them; None: those of their rollout.
    """

    task: Task
    disturbance: Disturbance
    guess: Array | None = None
    guess_states: Array | None = None


def situations(task: Task, settings: SearchSettings, seed: int) -> list[Situation]:
    """Draws the situations; see the settings `situations` and `disturb`.

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
    disturbed(task, draw_disturbance(task, settings.disturb, rng))


def initial_states(task: Task, settings: SearchSettings, seed: int) -> list[Array]:
    """Returns x_1 of each situation: the task's, of which the others are draws around it."""
    rng = generator(seed, Stream.INITIAL_STATES)
    draws = rng.standard_normal((settings.situations, len(task.varied_state_std)))
    others = task.dynamics.space.add(task.initial_state, task.varied_state_std * draws)[1:]
    return [task.initial_state, *others]


def _situation(task: Task, settings: SearchSettings, seed: int, i: int, start: Array) -> Situation:
    rng, rng_of_motion = (
        generator(seed, stream, i) for stream in (Stream.DISTURBANCES, Stream.INITIAL_CONTROLS)
    )
    disturbance = draw_disturbance(task, settings.disturb, rng)
    latest = settings.disturb.start_before if i else 0.0
    begun = round(latest * rng.uniform() / task.dynamics.time_step)
    guess, states = None, task.path
    if begun:
        motion = _later(task, start, begun, rng_of_motion)
        start, guess, states = motion.states[0], motion.controls, motion.states
    elif task.guess:
        guess = task.guess(rng_of_motion)
    here = replace(disturbed(task, disturbance), initial_state=start)
    return Situation(here, disturbance, guess, states)


def _check_later_starts(task: Task, count: int) -> None:
    """Checks that some situation can start on the way of the first motion."""
    if task.demonstrate is None:
        raise InvalidInputError(
            f"disturb.start_before is set, but the first motion of the task {task.name} follows no "
            "law that could go on for longer; leave it out."
        )
    if count == 1:
        raise InvalidInputError(
            "disturb.start_before is set, but the first situation starts where the task does, and "
            "there is no other one; set situations to 2 or more, or leave it out."
        )


def _later(task: Task, start: Array, begun: int, rng: np.random.Generator) -> Trajectory:
    """Returns the task's first motion from a start on, but without its first steps."""
    assert task.demonstrate is not None
    motion = task.demonstrate(start, begun + task.planned_horizon, rng)
    return Trajectory(motion.states[begun:], motion.controls[begun:])
