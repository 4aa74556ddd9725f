# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Courses: velocities that a robot is commanded, one leg after another, and the path they ask for.

A file of a course is a YAML list of legs. Each has its duration [s], and velocities as a message on
`cmd_vel` has them [m/s, rad/s]; what is left out is zero:

    - {duration: 6.0, linear: {x: 0.4}, angular: {z: 0.5}}
    - {duration: 2.0, linear: {y: 0.2}}
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.core.checks import finite_array, positive, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Range, Setting
from vgps_ros.storage.files import read_file, read_yaml

FIELDS = ("linear/x", "linear/y", "linear/z", "angular/x", "angular/y", "angular/z")
FIGURE_OF_EIGHT = "figure_of_eight"
SPEED = Setting("speed", 0.4, Range(1e-3, 100.0), f"forward speed of {FIGURE_OF_EIGHT} [m/s]")
TURN = Setting(
    "turn",
    0.5,
    Range(1e-3, 100.0),
    f"turning speed of {FIGURE_OF_EIGHT}, whose circles have the radius speed / turn [rad/s]",
)
_LONGEST = 86_400.0  # [s]


@dataclass(frozen=True)
class Course:
    """Velocities that are commanded one after another; after the last leg the robot rests.

    Attributes:
        durations: of n legs, shape (n,), [s].
        velocities: those of `FIELDS` in each leg, shape (n, 6), [m/s, rad/s].
    """

    durations: Array
    velocities: Array

    @cached_property
    def ends(self) -> Array:
        """Time at which each leg ends, shape (n,), [s]."""
        return np.asarray(self.durations.cumsum())

    @property
    def duration(self) -> float:
        """Time of all legs [s]."""
        return float(self.ends[-1])

    def at(self, time: float) -> Array:
        """Returns what is commanded at a time [s] from the start on, shape (6,)."""
        leg = int(np.searchsorted(self.ends, time, side="right"))
        return self.velocities[leg] if leg < len(self.ends) else np.zeros(len(FIELDS))


def figure_of_eight(speed: float, turn: float) -> Course:
    """Returns a circle to the left and one to the right, with a second of rest before and after.

    The speeds are ahead [m/s] and about the vertical [rad/s].
    """
    velocities = np.zeros((4, len(FIELDS)))
    velocities[1:3, FIELDS.index("linear/x")] = speed
    velocities[1:3, FIELDS.index("angular/z")] = turn, -turn
    circle = 2.0 * np.pi / turn
    return Course(np.array([1.0, circle, circle, 1.0]), velocities)


def course_of(name: str, speed: float = SPEED.default, turn: float = TURN.default) -> Course:
    """Returns the figure of eight at these speeds, or the course in a file.

    Raises:
        InvalidInputError: the file cannot be read, or holds no course.
    """
    if name == FIGURE_OF_EIGHT:
        return figure_of_eight(speed, turn)
    path = Path(name)
    try:
        text = read_file(path)
    except OSError as error:
        raise InvalidInputError(
            f"The course '{path}' cannot be read ({error.strerror}); name {FIGURE_OF_EIGHT}, or a "
            "file of legs, as `vgps drive --help` shows it."
        ) from error
    legs = read_yaml(text, f"'{path}'")
    if not isinstance(legs, list) or not legs:
        raise InvalidInputError(
            f"'{path}' holds no course: it must be a list of legs such as "
            "{duration: 6.0, linear: {x: 0.4}, angular: {z: 0.5}}."
        )
    read = [_leg(leg, f"Leg {i} of '{path}'") for i, leg in enumerate(legs, start=1)]
    durations, velocities = zip(*read, strict=True)
    if (total := sum(durations)) > _LONGEST:
        raise InvalidInputError(f"'{path}' lasts {total:g} s, but at most {_LONGEST:g} s may be.")
    return Course(np.array(durations), np.array(velocities))


def _leg(leg: Any, name: str) -> tuple[float, list[float]]:
    """Returns the duration [s] and the velocities of a leg, whose name is for errors."""
    given = dict[str, Any]()
    for key, value in leg.items() if isinstance(leg, dict) else ():
        is_vector = key in ("linear", "angular") and isinstance(value, dict)
        given |= {f"{key}/{axis}": v for axis, v in value.items()} if is_vector else {key: value}
    if unknown := [key for key in given if key not in ("duration", *FIELDS)]:
        raise InvalidInputError(
            f"{name} has {quote(unknown[0])}, but a leg has a duration, and linear and angular "
            "velocities with x, y and z."
        )
    if "duration" not in given:
        raise InvalidInputError(f"{name} needs a duration [s].")
    positive(f"The duration of {name}", finite_array(name, given["duration"], (1,))[0])
    numbers = finite_array(name, [given.get(key, 0.0) for key in ("duration", *FIELDS)], (7,))
    return float(numbers[0]), numbers[1:].tolist()


def asked_path(velocities: Array, time_step: float, start: Sequence[float]) -> Array:
    """Returns the path of a robot that does exactly what it is told.

    Args:
        velocities: ahead, to the left and about the vertical in each step, in the robot's axes,
            shape (T, 3), [m/s, rad/s].
        time_step: of each [s].
        start: x, y and yaw at the beginning [m, rad].

    Returns:
        x, y and yaw before each step and after the last one, shape (T+1, 3).
    """
    turned = velocities[:, 2] * time_step
    yaw = start[2] + np.concatenate([[0.0], turned.cumsum()])
    halfway = yaw[:-1] + 0.5 * turned
    cos, sin = np.cos(halfway), np.sin(halfway)
    ahead, left = velocities[:, 0], velocities[:, 1]
    steps = np.stack([cos * ahead - sin * left, sin * ahead + cos * left], axis=1) * time_step
    places = np.concatenate([[start[:2]], start[:2] + steps.cumsum(axis=0)])
    return np.concatenate([places, yaw[:, None]], axis=1)
