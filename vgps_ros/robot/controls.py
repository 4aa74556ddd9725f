# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What each control of a robot is: its kind, its unit, and how it acts on what it drives.

A control u drives a coordinate y: a joint's position, or a fixed tendon's length. Behind its gear
an actuator of MuJoCo exerts the force

    τ = s u + b − k_p y − k_d ẏ                                                          (1)

on y, from which its kind follows:

| kind | where | w, its value at the joint | w at rest |
| --- | --- | --- | --- |
| torque, force | k_p = k_d = 0 | s u + b, the force [N·m, N] | 0 |
| position | k_p > 0 | (s u + b) / k_p, the y at which a joint at rest feels no force [rad, m] | y |
| velocity | k_p = 0, k_d > 0 | (s u + b) / k_d [rad/s, m/s] | 0 |
| activation | any other actuator, such as a muscle | u | 0 |

A servo whose activation integrates u is one of velocities, too: its target moves at w = s u / k_p.
Policies, costs and the limits of a model are about u; messages and parameters are about w and τ,
which a robot's driver knows.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from itertools import compress, repeat
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.checks import Shape
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array

# A control beyond it has diverged; MuJoCo replaces one beyond 1e10 by zero and would hide it.
CONTROL_BOUND = 1e9

Mask = NDArray[np.bool_]
_Number = Annotated[Array, Shape("n_u")]
_SAME_GAIN = 1e-5  # relative difference of two gains that are the same but for their text


class ControlKind(StrEnum):
    """The kinds that a control may be of."""

    TORQUE = "torque"
    FORCE = "force"
    POSITION = "position"
    VELOCITY = "velocity"
    ACTIVATION = "activation"

    @property
    def field(self) -> str:
        """The field of a JointState in which it stands."""
        return self.value if self in (self.POSITION, self.VELOCITY) else "effort"

    @property
    def units(self) -> tuple[str, ...]:
        """The units that it may have: where y is an angle, and where it is a length."""
        return _UNITS[self]


_UNITS = {
    ControlKind.TORQUE: ("N·m",),
    ControlKind.FORCE: ("N",),
    ControlKind.POSITION: ("rad", "m"),
    ControlKind.VELOCITY: ("rad/s", "m/s"),
    ControlKind.ACTIVATION: ("1",),
}
# The command of each kind that is sent when idle.
_AT_REST = {
    ControlKind.TORQUE: "torques are zero",
    ControlKind.FORCE: "forces are zero",
    ControlKind.POSITION: "servos hold their positions",
    ControlKind.VELOCITY: "servos brake",
    ControlKind.ACTIVATION: "activations are zero",
}
# What ros2_control's hardware takes of a joint; the last two are the gains of its own loop.
INTERFACES = ("position", "velocity", "effort", "stiffness", "damping")
_COLUMNS = {"position": "position_target", "velocity": "velocity_target", "effort": "effort"}


@dataclass(frozen=True, eq=False)
class Controls:
    """The n_u controls of a robot, in the order of its actuators; the module explains the letters.

    Attributes:
        names: the joints that they drive; where one drives no joint of its own, the actuators.
        kinds: what each is.
        units: unit of w of each.
        limits: lowest and highest u, shapes (n_u,).
        strength: s, shape (n_u,); of an activation 1.
        bias: b, shape (n_u,) [N·m, N].
        stiffness: k_p, shape (n_u,) [N·m/rad, N/m].
        damping: k_d, shape (n_u,) [N·m·s/rad, N·s/m].
        scale: ∂w/∂u, shape (n_u,).
        offset: w at u = 0, shape (n_u,).
        servo_forces: largest |τ| that the model lets a servo exert, shape (n_u,); 1e9 for no limit.
        positions: P with y = P x, shape (n_u, n_x); a row is zero where no state tells y.
        velocities: V with ẏ = V x, likewise.
        restless: names of the controls for which nothing is known that leaves the robot alone.
    """

    names: tuple[str, ...]
    kinds: tuple[ControlKind, ...]
    units: tuple[str, ...]
    limits: tuple[Array, Array]
    strength: _Number
    bias: _Number
    stiffness: _Number
    damping: _Number
    scale: _Number
    offset: _Number
    servo_forces: _Number
    positions: Annotated[Array, Shape("n_u", "n_x")]
    velocities: Annotated[Array, Shape("n_u", "n_x")]
    restless: tuple[str, ...]

    def are(self, *kinds: ControlKind) -> Mask:
        """Returns which controls are of one of these kinds, shape (n_u,)."""
        return np.array([kind in kinds for kind in self.kinds], dtype=bool)

    @cached_property
    def are_braked(self) -> Mask:
        """Mask of those that can brake: servos, and motors whose ẏ a state tells, shape (n_u,)."""
        return self._hold | self.are(ControlKind.VELOCITY) | self._are_motors & self._are_measured

    @cached_property
    def _hold(self) -> Mask:
        return self.are(ControlKind.POSITION)

    @cached_property
    def _are_motors(self) -> Mask:
        return self.are(ControlKind.TORQUE, ControlKind.FORCE)

    @cached_property
    def _are_measured(self) -> Mask:
        return np.asarray(self.positions.any(axis=1))

    @cached_property
    def are_servos(self) -> Mask:
        """Mask of those whose force depends on the state, shape (n_u,)."""
        return np.asarray(self.stiffness + self.damping > 0.0)

    @property
    def at_rest(self) -> str:
        """The part of a sentence that says what they do where the robot is left alone."""
        return " and the ".join(_AT_REST[kind] for kind in dict.fromkeys(self.kinds))

    def label(self, mask: Iterable[bool] = repeat(True)) -> str:
        """Returns the kinds and units of some controls, such as `position [rad]`."""
        pairs = compress(zip(self.kinds, self.units, strict=True), mask)
        return ", ".join(f"{kind} [{unit}]" for kind, unit in dict.fromkeys(pairs))

    @cached_property
    def fields(self) -> dict[str, Mask]:
        """Which controls belong to each field of a JointState that is used, as masks."""
        used = [kind.field for kind in self.kinds]
        return {name: np.array([each == name for each in used]) for name in dict.fromkeys(used)}

    @property
    def columns(self) -> list[str]:
        """Their names in a table, such as `knee/effort` or `knee/position_target`."""
        pairs = zip(self.names, self.kinds, strict=True)
        return [f"{name}/{_COLUMNS[kind.field]}" for name, kind in pairs]

    @cached_property
    def largest(self) -> Array:
        """Largest |τ| within the limits of the model, shape (n_u,) [N·m, N]; 1e9 for no limit."""
        ends = np.abs([self.strength * end + self.bias for end in self.limits]).max(axis=0)
        return np.where(self.are_servos, self.servo_forces, np.minimum(ends, CONTROL_BOUND))

    @property
    def least(self) -> Array:
        """Smallest |τ| within the limits of the model, shape (n_u,) [N·m, N]; of servos 0."""
        low, high = np.sort([self.strength * end + self.bias for end in self.limits], axis=0)
        return np.where(self.are_servos, 0.0, np.maximum(np.maximum(low, -high), 0.0))

    def with_servos(self, stiffness: Array, damping: Array) -> "Controls":
        """Returns the controls where loops of positions are closed with other gains.

        A motor keeps its limits of torque. What has these gains already, or shall have none, stays.

        Args:
            stiffness: k_p at each joint, shape (n_u,) [N·m/rad, N/m].
            damping: k_d at each joint, shape (n_u,) [N·m·s/rad, N·s/m].

        Raises:
            InvalidInputError: a gain does not suit its control.
        """
        gains, own = np.array([stiffness, damping]), np.array([self.stiffness, self.damping])
        stays = np.isclose(gains, own, rtol=_SAME_GAIN, atol=0.0).all(axis=0)
        stays |= ~gains.any(axis=0)
        fits = (self._are_motors | self._hold) & self._are_measured & (stiffness > 0.0)
        for i in np.flatnonzero(~stays & ~(fits & (damping >= 0.0))):
            raise InvalidInputError(
                f"{self.names[i]} shall have a stiffness of {stiffness[i]:g} and a damping of "
                f"{damping[i]:g}; but a loop needs a stiffness above 0, and a motor or servo of "
                "positions; change joint_stiffness and joint_damping."
            )
        ends = np.sort([self.at_joints(end) for end in self.limits], axis=0)
        ends = np.where(self._hold & np.isfinite(ends).all(axis=0), ends, [[-np.inf], [np.inf]])
        low, high = np.where(stays, self.limits, ends)
        turned = {"N·m": "rad", "N": "m"}
        kinds = [k if s else ControlKind.POSITION for k, s in zip(self.kinds, stays, strict=True)]
        units = [u if s else turned.get(u, u) for u, s in zip(self.units, stays, strict=True)]
        return replace(
            self,
            kinds=tuple(kinds),
            units=tuple(units),
            limits=(low, high),
            strength=np.where(stays, self.strength, stiffness),
            bias=np.where(stays, self.bias, 0.0),
            stiffness=np.where(stays, self.stiffness, stiffness),
            damping=np.where(stays, self.damping, damping),
            scale=np.where(stays, self.scale, 1.0),
            offset=np.where(stays, self.offset, 0.0),
            servo_forces=np.where(stays, self.servo_forces, self.largest),
        )

    def at_joints(self, control: Array) -> Array:
        """Returns w, shape (..., n_u), of u."""
        return self.scale * control + self.offset

    def from_joints(self, values: Array) -> Array:
        """Returns u, shape (..., n_u), of w."""
        return (values - self.offset) / self.scale

    def by_interface(self, control: Array, names: Sequence[str]) -> Array:
        """Returns what interfaces of ros2_control get, a row each, shape (len(names), n_u).

        What a control is not is zero: with the gains, hardware exerts k_p (q* − q) + k_d (q̇* − q̇)
        plus the effort.
        """
        values = self.at_joints(control)
        rows = {name: np.where(mask, values, 0.0) for name, mask in self.fields.items()}
        rows |= {"stiffness": self.stiffness, "damping": self.damping}
        return np.array([rows.get(name, np.zeros_like(values)) for name in names])

    def resting(self, state: Array) -> Array:
        """Returns u that leaves the robot alone in a state (n_x,), shape (n_u,): w at rest."""
        held = np.where(self._hold, (self.positions * state).sum(axis=1), 0.0)
        return np.clip(self.from_joints(held), *self.limits)

    def holding(self, state: Array) -> Array:
        """Returns u as at rest, but a servo stays where it is also beyond its control's limits."""
        held = self.from_joints((self.positions * state).sum(axis=1))
        return np.where(self._hold & self._are_measured, held, self.resting(state))

    def carrying(self, state: Array, forces: Array) -> Array:
        """Returns u by which servos of positions exert forces τ (n_u,) in a state at rest, (n_u,).

        Other controls are at rest.
        """
        carried = self.stiffness * (self.positions @ state) + forces - self.bias  # by (1)
        servos = self._hold & self._are_measured
        control = np.where(servos, carried / self.strength, self.resting(state))
        return np.clip(control, *self.limits)

    def braking(self, state: Array, damping: float, resting: Array) -> Array:
        """Returns u with τ = −damping ẏ of motors, shape (n_u,); the others stay at rest."""
        rates = (self.velocities * state).sum(axis=1)
        return np.where(self._are_motors, self.from_joints(-damping * rates), resting)

    def pulling(
        self, state: Array, pose: Array, stiffness: float, damping: float, beyond: Array | float
    ) -> Array:
        """Returns u that pulls a state (n_x,) towards the joints' positions in a pose, (n_u,).

        Motors have τ = stiffness (y* − y) − damping ẏ, servos of positions the target y*, which is
        `beyond` the pose's, shape (n_u,).
        """
        y, goal = self.positions @ state, self.positions @ pose + beyond
        forces = stiffness * (goal - y) - damping * (self.velocities @ state)
        values = np.where(self._are_motors, forces, np.where(self._hold, goal, 0.0))
        return np.clip(self.from_joints(values), *self.limits)

    def asked(self, state: Array, control: Array, stiffness: float, damping: float) -> Array:
        """Returns how far beyond a state (n_x,) a control pulls: the inverse of `pulling`, (n_u,).

        It is 0 of what is no motor or servo of positions.
        """
        values, y = self.at_joints(control), self.positions @ state
        forces = values + damping * (self.velocities @ state)
        of_motors = forces / stiffness if stiffness else np.zeros_like(forces)
        return np.where(self._are_motors, of_motors, np.where(self._hold, values - y, 0.0))

    def bounds(self, states: Array, forces: Array) -> tuple[Array, Array]:
        """Returns the lowest and the highest u in states (..., n_x), shapes (..., n_u).

        They are within the limits of the model, and the forces τ on the joints within ±`forces`,
        shape (n_u,). Where both cannot be, the limits of the model hold.
        """
        low, high = np.clip(self.limits, -CONTROL_BOUND, CONTROL_BOUND)
        shape = (*states.shape[:-1], len(low))
        passive = np.broadcast_to(self.bias, shape)  # τ at u = 0
        if self.are_servos.any():
            passive = passive - self.stiffness * (states @ self.positions.T)
            passive = passive - self.damping * (states @ self.velocities.T)
        ends = np.sort([(side - passive) / self.strength for side in (-forces, forces)], axis=0)
        is_free = forces >= self.largest  # rounding must not make limits narrower
        lowest, highest = (np.where(is_free, *pair) for pair in zip((low, high), ends, strict=True))
        return np.clip(lowest, low, high), np.clip(highest, low, high)
