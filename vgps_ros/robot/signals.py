# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a policy is told as it runs: commands, such as a speed to walk at, and a clock.

They are the context z of a step (see `core.observation`). Nothing of them is a state: an
optimisation knows them ahead, the cost may follow them, the policy may read them, and whoever
executes a policy tells it their values.

A command at rest is zero, or the value of its range that is nearest to zero. The clock is a phase
φ = f t in turns, of which the policy reads sin 2πφ and cos 2πφ. It may stand still while all
commands are at rest: both are zero then, and so is each swing that follows the clock. It turns
there while the robot has to step (see `robot.unrest`).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Range

CLOCK = ("clock/sin", "clock/cos")
SOURCE = re.compile(r"cmd_vel/(linear|angular)/[xyz]")  # of a command
_EACH_AT_REST = 0.3  # share of the draws in which a command by itself is at rest
_SHARE_OF_RANGE, _OF_CLOCK = 0.25, 0.5  # standard deviations of a command and of the clock


@dataclass(frozen=True)
class Command:
    """A number that a policy is told to bring about.

    Attributes:
        name: its name.
        lowest: the smallest value that the policy learns.
        highest: the largest value.
        source: the topic and the field that it comes from, as cmd_vel/linear/x; empty: it comes by
            the topic of all commands alone.
        unit: its unit, for people.
    """

    name: str
    lowest: float
    highest: float
    source: str = ""
    unit: str = ""

    @property
    def rest(self) -> float:
        """The value where nothing is commanded: zero, or what is nearest to it."""
        return min(max(0.0, self.lowest), self.highest)


@dataclass(frozen=True)
class CommandSettings:
    """Settings of the commands that situations draw."""

    still: Annotated[
        float, Range(0.0, 1.0), "share of the situations in which all commands are at rest"
    ] = 0.12


@dataclass(frozen=True)
class Signals:
    """The commands and the clock of a task, which may have neither.

    Attributes:
        commands: the commands.
        frequency: of the clock [Hz]; 0: there is no clock.
        time_step: time of a control step [s].
        stops: whether the clock stands still while all commands are at rest.
    """

    commands: tuple[Command, ...] = ()
    frequency: float = 0.0
    time_step: float = 0.0
    stops: bool = False

    @property
    def turning(self) -> "Signals":
        """The same with a clock that always turns, as it does for a robot that has to step."""
        return replace(self, stops=False)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the numbers of a context; there are n_z."""
        clock = CLOCK if self.frequency else ()
        return (*(f"command/{c.name}" for c in self.commands), *clock)

    @property
    def period(self) -> float:
        """Time of a turn of the clock [s]; 0: there is no clock."""
        return 1.0 / self.frequency if self.frequency else 0.0

    @property
    def nominal(self) -> Array:
        """The middle of each command's range, shape (n_c,)."""
        return np.array([0.5 * (c.lowest + c.highest) for c in self.commands])

    @cached_property
    def rest(self) -> Array:
        """The commands where nothing is commanded, shape (n_c,)."""
        return np.array([c.rest for c in self.commands])

    def draw(self, rng: np.random.Generator, settings: CommandSettings) -> Array:
        """Draws commands, shape (n_c,); see the settings."""
        n = len(self.commands)
        share, *values = rng.uniform(size=1 + n)
        pairs = zip(self.commands, values, strict=True)
        drawn = np.array([c.lowest + (c.highest - c.lowest) * value for c, value in pairs])
        at_rest = rng.uniform(size=n) < _EACH_AT_REST
        if share < settings.still:
            at_rest[:] = True
        elif at_rest.all() and n:
            at_rest[int(rng.integers(n))] = False
        return np.where(at_rest, self.rest, drawn)

    def phases(self, steps: int, first: float) -> Array:
        """Returns φ of some steps, shape (steps,), in turns, from that of the first one."""
        return np.asarray((first + self.frequency * self.time_step * np.arange(steps)) % 1.0)

    def phase_at(self, stamp: int) -> float:
        """Returns φ at a time [ns], in turns."""
        return float(self.frequency * (stamp * 1e-9) % 1.0)

    def context(self, commands: Array, phases: Array) -> Array:
        """Returns z, shape (..., n_z), for commands (..., n_c) and φ (...,)."""
        if not self.frequency:
            return commands
        turned = 2.0 * np.pi * phases
        clock = np.stack([np.sin(turned), np.cos(turned)], axis=-1)
        if self.stops:
            moves = (commands != self.rest).any(axis=-1, keepdims=True)
            clock = np.where(moves, clock, 0.0)
        return np.concatenate([commands, clock], axis=-1)

    def phase_of(self, context: Array) -> float:
        """Returns φ of a context (n_z,), in turns; 0 where no clock turns."""
        if not self.frequency:
            return 0.0
        return float(np.arctan2(*context[-2:]) / (2.0 * np.pi) % 1.0)

    def constant_context(self, commands: Array, steps: int, first: float = 0.0) -> Array:
        """Returns z of some steps in which the commands (n_c,) do not change, (steps, n_z)."""
        each = np.tile(np.asarray(commands, dtype=float), (steps, 1))
        return self.context(each, self.phases(steps, first))

    def spread(self, told: Sequence[str]) -> Array:
        """Returns standard deviations of numbers that a policy is told, by name, shape (c,).

        By them a distance from a training judges other commands, since a policy learns from some
        commands what to do in all between them.
        """
        ranges = {f"command/{c.name}": c.highest - c.lowest for c in self.commands}
        return np.array(
            [_SHARE_OF_RANGE * ranges[name] if name in ranges else _OF_CLOCK for name in told]
        )

    def clamped(self, given: Mapping[str, float]) -> tuple[dict[int, float], list[str]]:
        """Returns the values of some commands within their ranges, by the commands' places.

        Returns:
            The values, and on each that is out of its range what is wrong.

        Raises:
            InvalidInputError: there is no command of a name.
        """
        places = {command.name: i for i, command in enumerate(self.commands)}
        if unknown := [name for name in given if name not in places]:
            raise InvalidInputError(
                f"there is no command {quote(unknown[0])}, but {', '.join(places)}."
            )
        taken, said = dict[int, float](), list[str]()
        for name, value in given.items():
            command = self.commands[places[name]]
            low, high = command.lowest, command.highest
            taken[places[name]] = min(max(value, low), high)
            if not low <= value <= high:
                unit = f" {command.unit}" if command.unit else ""
                said.append(f"{name} is {value:g}, but it must be from {low:g} to {high:g}{unit}")
        return taken, said

    def check(self, values: Sequence[float]) -> Array:
        """Returns the values of commands that come from outside, shape (n_c,).

        Raises:
            InvalidInputError: there is not one for each command, or one is out of its range.
        """
        if len(values) != len(self.commands):
            names = ", ".join(c.name for c in self.commands) or "none"
            raise InvalidInputError(
                f"{len(values)} values are given, but the task has {len(self.commands)} commands: "
                f"{names}."
            )
        given = zip((command.name for command in self.commands), values, strict=True)
        _, said = self.clamped(dict(given))
        if said:
            raise InvalidInputError(f"The command {said[0]}.")
        return np.array(values, dtype=float)
