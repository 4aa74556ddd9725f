# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Disturbances of a robot, as numbers that a request carries; to name them takes no MuJoCo.

A policy that shall bear pushes, loads, slopes and other joints learns from situations: each has a
start and a disturbance of its own, and its own q(ζ), since the dynamics differ.
`disturbed_task.py` makes the task that a disturbance leads to.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Range

_STEEPEST = 1.0  # [rad]
_WEAKEST = 0.01  # of the largest forces; MuJoCo takes an empty range for none


@dataclass(frozen=True)
class Disturbance:
    """A push, a load, the ground and the joints of one situation; by default nothing is changed.

    Attributes:
        body: name of the body that is pushed and bears the payload.
        push: horizontal impulse along x and y on the body's centre of mass [N·s].
        push_time: time at which the push begins [s].
        push_duration: time over which its force is spread [s].
        payload: mass that is added at the body's centre of mass [kg].
        friction: factor on the friction of all contacts.
        slope: angles by which the ground rises along x and y [rad].
        ridges: largest height of ridges in the ground [m].
        ridges_seed: seed of their places and heights.
        steps: height of steps up and down in the ground, across the way [m].
        damping: factor on the damping of all joints.
        armature: factor on the armature of all joints, the inertia of their rotors.
        strength: factor on the largest forces of all actuators.
        gain: factor on the gain of all actuators: a servo's stiffness and damping, a motor's force.
        friction_loss: dry friction that is added to all joints with an actuator [N·m, N].
    """

    body: str = ""
    push: tuple[float, float] = (0.0, 0.0)
    push_time: float = 0.0
    push_duration: float = 0.1
    payload: float = 0.0
    friction: float = 1.0
    slope: tuple[float, float] = (0.0, 0.0)
    ridges: float = 0.0
    ridges_seed: int = 0
    steps: float = 0.0
    damping: float = 1.0
    armature: float = 1.0
    strength: float = 1.0
    gain: float = 1.0
    friction_loss: float = 0.0

    def __post_init__(self) -> None:
        """Checks the numbers, which may come from a message."""
        numbers = {
            "push": (*self.push, -np.inf, np.inf),
            "push_time": (self.push_time, 0.0, np.inf),
            "push_duration": (self.push_duration, 0.0, np.inf),
            "payload": (self.payload, 0.0, np.inf),
            "friction": (self.friction, 0.0, np.inf),
            "slope": (*self.slope, -_STEEPEST, _STEEPEST),
            "ridges": (self.ridges, 0.0, 1.0),
            "steps": (self.steps, 0.0, 1.0),
            "damping": (self.damping, 0.0, np.inf),
            "armature": (self.armature, 0.0, np.inf),
            "strength": (self.strength, _WEAKEST, np.inf),
            "gain": (self.gain, _WEAKEST, np.inf),
            "friction_loss": (self.friction_loss, 0.0, np.inf),
        }
        for name, (*values, low, high) in numbers.items():
            if not all(np.isfinite(value) and low <= value <= high for value in values):
                raise InvalidInputError(
                    f"disturbance.{name} is {getattr(self, name)}, but it must be finite and from "
                    f"{low:g} to {high:g}."
                )

    @property
    def changes_model(self) -> bool:
        """True if it changes more than a push does: the robot or the ground."""
        factors = (self.friction, self.damping, self.armature, self.strength, self.gain)
        added = self.payload or self.friction_loss or self.ridges or self.steps
        return bool(added or any(self.slope) or any(f != 1.0 for f in factors))


@dataclass(frozen=True)
class DisturbanceSettings:
    """Settings of the situations that are drawn, each with a disturbance."""

    start_before: Annotated[
        float,
        Range(0.0, 1e6),
        "time of the first motion before which all but the first situation start [s]",
    ] = 0.0
    body: Annotated[str, "body that is pushed and bears a payload; empty: the heaviest one"] = ""
    push: Annotated[float, Range(0.0, 1e6), "horizontal impulse in a random direction [N*s]"] = 0.0
    push_before: Annotated[
        float,
        Range(0.0, 1e6),
        "time before which it begins [s]; 0: at once, so that no motion is optimised to await it",
    ] = 0.0
    push_duration: Annotated[float, Range(1e-6, 1e3), "time over which a push is spread [s]"] = 0.1
    payload: Annotated[float, Range(0.0, 1e6), "largest mass that is added to the body [kg]"] = 0.0
    friction: Annotated[float, Range(0.0, 0.99), "largest change of friction, as a share of it"] = (
        0.0
    )
    slope: Annotated[
        float, Range(0.0, _STEEPEST), "largest slope of the ground, up or down [rad]"
    ] = 0.0
    ridges: Annotated[float, Range(0.0, 1.0), "largest height of ridges in the ground [m]"] = 0.0
    steps: Annotated[float, Range(0.0, 1.0), "largest height of steps in the ground [m]"] = 0.0
    joints: Annotated[
        float,
        Range(0.0, 100.0),
        "largest change of the joints' damping, and of their armature: 1 is from half to twice",
    ] = 0.0
    strength: Annotated[
        float, Range(0.0, 0.99), "largest loss of the actuators' largest force, as a share of it"
    ] = 0.0
    gain: Annotated[
        float,
        Range(0.0, 100.0),
        "largest change of the actuators' gain, a servo's stiffness and damping or a motor's "
        "force: 0.1 is from 1/1.1 to 1.1 times",
    ] = 0.0
    friction_loss: Annotated[
        float,
        Range(0.0, 1e6),
        "largest dry friction that is added to the joints with an actuator [N*m]",
    ] = 0.0


def check_push_ends(
    settings: DisturbanceSettings, seconds: float, what: str, shorten: str, otherwise: str
) -> None:
    """Checks that each push that may be drawn is over before a motion of so many seconds is.

    The texts name the motion, the settings to make smaller, and what else there is to do.

    Raises:
        InvalidInputError: a push may come too late, or last too long.
    """
    if settings.push_before + settings.push_duration > seconds * (1.0 + 1e-9):
        raise InvalidInputError(
            f"A push may begin as late as {settings.push_before:g} s and lasts "
            f"{settings.push_duration:g} s, but {what} ends after {seconds:g} s, before its "
            f"impulse is whole; shorten {shorten}, or {otherwise}."
        )
