# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What the numbers of a third-party network mean: the contract between it and a robot.

It is written in the metadata of the ONNX file, by the keys that mjlab writes and some of our own
(docs/how_to/import_a_policy.md, which lists the terms). A network reads terms, one after another.

Any other term is one number, by the name of a reading, a command or the clock. Each is clipped,
then scaled. Of a term with a history the numbers of former steps come too; before the first step
all were as in it. A term's history comes as a whole, or (`observation_order` is time) step by step.

Action a_i asks joint i for p_0 + s a_i, or the torque s a_i where it has no stiffness. Joints that
the network does not drive, `held_joint_names`, are held where `held_joint_pos` has them.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.checks import check_spelling, finite_array, nearest, one_of, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.memory import Memory
from vgps_ros.core.records import Array
from vgps_ros.policies.onnx_file import names_of, numbers_of

BASE = "the free base"  # stands for the name of its joint among what a network reads
_ROTATION = tuple(f"{BASE}/q{axis}" for axis in "wxyz")
_VELOCITY = tuple(f"{BASE}/v{axis}" for axis in "xyz")
VELOCITY_COMMANDS = ("cmd_vel/linear/x", "cmd_vel/linear/y", "cmd_vel/angular/z")
HELD, STATE = "held_joint_names", "state_initial"
CONTEXTS = ("command/", "clock/", "cmd_vel/")
# Each term with the other names of it; the joints' are `joint_pos`, `joint_vel`, `last_action`.
TERMS: dict[str, tuple[str, ...]] = {
    "base_lin_vel": ("lin_vel",),
    "base_ang_vel": ("ang_vel",),
    "projected_gravity": ("gravity_vec",),
    "joint_pos": ("joint_pos_rel", "dof_pos"),
    "joint_vel": ("joint_vel_rel", "dof_vel"),
    "last_action": ("actions", "action"),
    "velocity_commands": ("command", "commands", "twist"),
    "gait_phase": (),
    "phase": (),
    "phase_cos": (),
    "phase_sin": (),
    "state": (),
}
_OTHERS = {other: term for term, others in TERMS.items() for other in others}
_READ = {
    "base_lin_vel": (*_ROTATION, *_VELOCITY),
    "base_ang_vel": tuple(f"{BASE}/w{axis}" for axis in "xyz"),
    "projected_gravity": _ROTATION,
    "last_action": (),
    "state": (),
    "velocity_commands": VELOCITY_COMMANDS,
    "gait_phase": ("clock/sin", "clock/cos"),
}
_PHASES = ("phase", "phase_cos", "phase_sin")  # in turns, up to 1; and of these turns
_AT_REST = 0.01  # length of the velocity commands below which phases rest, as in Playground
_OF_JOINTS = {"joint_pos": "position", "joint_vel": "velocity"}
_KEYS = (
    *("joint_names", "joint_stiffness", "joint_damping", "default_joint_pos", "command_names"),
    *("observation_names", "observation_order", "observation_clip", "observation_terms_lags"),
    *("observation_terms_scale", "observation_terms_clip", "observation_terms_history_length"),
    *("observation_terms_flatten_history_dim", "action_scale", "action_clip", "target_clip"),
    *("action_kind", "action_unit", "control_period", "gait_period", "gait_stops", HELD, STATE),
    *("phase_frequency", "phase_initial", "phase_rest"),
    *("held_joint_pos", "held_joint_stiffness", "held_joint_damping"),
)
_LONGEST = 1000  # history, in steps
_MOST = 100_000  # numbers that a network reads


@dataclass(frozen=True)
class Term:
    """A term of an observation."""

    name: str  # as its file has it
    kind: str  # the name in `TERMS`; of one number, its own name
    read: tuple[str, ...]  # the numbers of which it is computed
    size: int  # how many numbers it has
    scale: Array  # of each, shape (size,)
    clip: tuple[float, float]  # the lowest and the highest value of each
    lags: tuple[int, ...]  # how many steps ago each copy of it was read, in their order


class Contract:
    """The contract of a network; see the module.

    Args:
        metadata: of the file, by key.
        name: what the sentence of an error calls the file.

    Attributes:
        joints: the joints that its actions drive, in their order; there are n_a.
        held: the joints that are held.
        terms: what it reads.
        observed: names of the numbers of which the terms are computed; those told come last.
        places: name, step before the newest one, and index of each number that the network reads.
        origin, scale, stiffness, damping: p_0, s, k_p and k_d of each joint, and then of each that
            is held.
        state: what a network with a state of its own begins with, shape (m,); it gives the next one
            behind its actions.
        phases: of the policy's own clock as it begins to drive, in turns, shape (p,).
        action_clip: lowest and highest action, shapes (n_a + m,).
        target_clip: lowest and highest p_0 + s a of each joint, and of each that is held.
        looped: indices of the joints with k_p or k_d.
        looped_places: places in `observed` of their positions and then velocities.
        steps: how many steps, with the newest, the network reads.
        remembers: whether the network reads anything of former steps.
        gait_period: time of a turn of its clock [s]; 0 if it says nothing of it.
        period: time between two actions [s]; 0 if it says nothing of it.

    Raises:
        InvalidInputError: a key is missing, or values do not fit each other.
    """

    def __init__(self, metadata: dict[str, str], name: str):
        check_spelling(f"The metadata of {name}", metadata, _KEYS)
        self.joints = names_of(metadata, "joint_names", name)
        self.held = names_of(metadata, HELD, name) if metadata.get(HELD) else ()
        self._name, count = name, len(self.joints)
        if twice := [each for each, n in Counter((*self.joints, *self.held)).items() if n > 1]:
            raise InvalidInputError(
                f"{name} names the joint {quote(twice[0])} twice; name it once."
            )

        def of_joints(key: str, default: float, of_held: str = "") -> Array:
            own = numbers_of(metadata, key, default, count, name)
            held = (
                numbers_of(metadata, of_held, 0.0, len(self.held), name, HELD) if of_held else 0.0
            )
            return np.concatenate([own, np.broadcast_to(held, len(self.held))])

        self.origin = of_joints("default_joint_pos", 0.0, "held_joint_pos")
        self.scale = of_joints("action_scale", 1.0)
        self.stiffness = of_joints("joint_stiffness", 0.0, "held_joint_stiffness")
        self.damping = of_joints("joint_damping", 0.0, "held_joint_damping")

        def listed(key: str, default: str = "") -> Array:
            text = metadata.get(key, default)
            return numbers_of({key: text}, key, 0.0, text.count(",") + bool(text), name, key)

        self.state = listed(STATE)
        self._frequency, self._rest = listed("phase_frequency"), listed("phase_rest")
        self.phases = listed("phase_initial", "0")[: None if self._frequency.size else 0]
        clips = self._clips(metadata.get("action_clip", "-inf;inf"), count)
        free = np.tile([-np.inf, np.inf], (len(self.state), 1))
        self.action_clip = np.concatenate([clips, free]).T
        self.observation_clip = self._clips(metadata.get("observation_clip", "-inf;inf"), 1)[0]
        limits = self._clips(metadata.get("target_clip", "-inf;inf"), count)
        free = np.tile([-np.inf, np.inf], (len(self.held), 1))
        self.target_clip = np.concatenate([limits, free]).T
        order = metadata.get("observation_order", "term")
        one_of(f"the metadata 'observation_order' of {name}", order, ["term", "time"])
        self.gait_period, self.period = (
            numbers_of(metadata, key, 0.0, 1, name, key).item()
            for key in ("gait_period", "control_period")
        )
        is_clock = self._frequency.size in (1, 3) and (self._frequency > 0.0).all() and self.period
        if self._rest.size > 1 or not (is_clock or not self._frequency.size):
            raise InvalidInputError(
                f"The metadata 'phase_frequency' of {name} must be a frequency, or the lowest, the "
                "highest and the length of the velocity commands that brings it, beside a "
                "'control_period'; no other way in which a clock follows commands can be said."
            )
        self.terms = self._terms(metadata, names_of(metadata, "observation_names", name))
        self.looped = np.flatnonzero((self.stiffness != 0.0) | (self.damping != 0.0))
        looped = [self.all_joints[i] for i in self.looped]
        looped_names = [f"{joint}/{kind}" for kind in _OF_JOINTS.values() for joint in looped]
        read = dict.fromkeys([*(each for term in self.terms for each in term.read), *looped_names])
        self.observed = tuple(sorted(read, key=lambda each: each.startswith(CONTEXTS)))
        places = {each: i for i, each in enumerate(self.observed)}
        self._told = [places[each] for each in VELOCITY_COMMANDS if each in places]
        self._columns = [[places[each] for each in term.read] for term in self.terms]
        self.looped_places = [places[each] for each in looped_names]
        self._scale = np.concatenate([term.scale for term in self.terms])
        clips = np.repeat([t.clip for t in self.terms], [t.size for t in self.terms], axis=0)
        self._lowest, self._highest = clips.T
        own = ("last_action", "state", *_PHASES)
        self.remembers = any(t.kind in own or max(t.lags) for t in self.terms)
        self.steps = 1 + max(max(term.lags) for term in self.terms)
        if self.steps * len(self._scale) > _MOST:
            raise InvalidInputError(
                f"{name} remembers {self.steps} steps of {len(self._scale)} numbers, but at most "
                f"{_MOST} in all may be remembered; use a smaller network."
            )
        self.places = self._placed(by_time=order == "time")
        self._lags, self._indices = (np.array([p[i] for p in self.places]) for i in (1, 2))

    def _listed(
        self, metadata: dict[str, str], key: str, default: str, count: int
    ) -> list[NDArray[np.float64]]:
        """Returns rows of numbers, separated by commas and in a row by ;, one for each of a count.

        One row stands for all.
        """
        words = metadata.get(key, default).split(",")
        words = words * count if len(words) == 1 else words
        if len(words) != count:
            raise InvalidInputError(
                f"The metadata {key!r} of {self._name} has {len(words)} values, but there must be "
                f"{count}: one for each term of 'observation_names', or one for all."
            )
        try:
            return [np.array([float(number) for number in word.split(";")]) for word in words]
        except ValueError as error:
            raise InvalidInputError(
                f"The metadata {key!r} of {self._name} must be numbers, separated by commas, and "
                f"within one term by semicolons ({error})."
            ) from error

    def _clips(self, text: str, count: int) -> Array:
        """Returns lowest and highest values, shape (count, 2)."""
        rows = self._listed({"clip": text}, "clip", "", count)
        if any(len(row) != 2 or not row[0] <= row[1] for row in rows):
            raise InvalidInputError(
                f"A clip of {self._name} must be a lowest and a highest value, such as -1;1, but "
                f"is {text!r:.80}."
            )
        return np.array(rows)

    def _terms(self, metadata: dict[str, str], names: tuple[str, ...]) -> tuple[Term, ...]:
        count, prefix = len(names), "observation_terms_"
        scales = self._listed(metadata, f"{prefix}scale", "1", count)
        clips = self._clips(metadata.get(f"{prefix}clip", "-inf;inf"), count)
        lengths = self._listed(metadata, f"{prefix}history_length", "0", count)
        flat = self._listed(metadata, f"{prefix}flatten_history_dim", "1", count)
        lags = self._listed(metadata, f"{prefix}lags", "nan", count)
        found, total = list[Term](), 0
        for i, name in enumerate(names):
            kind = _OTHERS.get(name, name)
            read = _READ.get(kind, (kind,))
            if kind in _OF_JOINTS:
                read = tuple(f"{joint}/{_OF_JOINTS[kind]}" for joint in self.joints)
            if kind in _PHASES:
                read = VELOCITY_COMMANDS * (self._rest.size or self._frequency.size > 1)
            size = {"base_lin_vel": 3, "projected_gravity": 3}.get(kind, len(read))
            size = {"last_action": len(self.joints), "state": len(self.state)}.get(kind, size)
            size = len(self.phases) if kind in _PHASES else size
            length = float(lengths[i][0])
            steps = np.arange(np.clip(np.nan_to_num(length), 1.0, _LONGEST + 1.0))[::-1]
            steps = lags[i] if np.isfinite(lags[i]).all() else steps
            sound = length >= 0.0 <= steps.min() and steps.max() < _LONGEST
            if not (sound and (steps % 1 == 0).all()):
                raise InvalidInputError(
                    f"The term '{name}' of {self._name} has a history of {length:g} steps, "
                    f"but it may have 0 to {_LONGEST}, and lags that are whole numbers below that."
                )
            if (total := total + size * len(steps)) > _MOST:
                raise InvalidInputError(
                    f"{self._name} reads more than {_MOST} numbers; use a smaller network."
                )
            if len(steps) > 1 and not flat[i].all():
                raise InvalidInputError(
                    f"The history of the term '{name}' of {self._name} is not flattened, but a "
                    "network must read one vector: export it with flatten_history_dim."
                )
            if len(scales[i]) not in (1, size):
                raise InvalidInputError(
                    f"The term '{name}' of {self._name} has {len(scales[i])} scales, but "
                    f"{size} numbers: give one for each, or one for all."
                )
            scale = finite_array(f"the scale of the term '{name}'", scales[i], (len(scales[i]),))
            clip = (float(clips[i, 0]), float(clips[i, 1]))
            back = tuple(int(step) for step in steps)
            found.append(Term(name, kind, read, size, np.resize(scale, size), clip, back))
        return tuple(found)

    def _placed(self, *, by_time: bool) -> list[tuple[str, int, int]]:
        """Returns term, lag and index in a frame of each number that the network reads."""
        blocks, first = [], 0
        for term in self.terms:
            own = range(first, first + term.size)
            blocks.append([[(term.name, lag, i) for i in own] for lag in term.lags])
            first += term.size
        if not by_time:
            return [number for block in blocks for row in block for number in row]
        if len({term.lags for term in self.terms}) > 1:
            raise InvalidInputError(
                f"The 'observation_order' of {self._name} is time, but its terms have different "
                "histories; give all the same."
            )
        rows = zip(*blocks, strict=True)
        return [number for row in rows for part in row for number in part]

    @property
    def all_joints(self) -> tuple[str, ...]:
        """Those that it drives, and then those that are held."""
        return (*self.joints, *self.held)

    @property
    def sizes(self) -> str:
        """How many numbers each term has, in words."""
        return ", ".join(f"{len(t.lags) * t.size} of {t.name}" for t in self.terms)

    @property
    def strange(self) -> str:
        """The first term that is taken for one number of that name; empty if there is none."""
        names = (t.name for t in self.terms if t.kind not in TERMS and "/" not in t.name)
        return next(names, "")

    def remembered(self, inputs: Array, memory: Memory | None) -> Memory:
        """Returns the action before and the frames with the newest of N robots.

        Args:
            inputs: what was observed, shape (N, len(observed)).
            memory: of the step before; None: this is the first.
        """
        if memory is None:
            first = np.concatenate([np.zeros(len(self.joints)), self.state, self.phases])
            action, before = np.tile(first, (len(inputs), 1)), None
        else:
            action, before = memory
        parts = [
            self._value(term.kind, inputs[:, columns], action)
            for term, columns in zip(self.terms, self._columns, strict=True)
        ]
        frame = np.concatenate(parts, axis=1)
        frame = np.minimum(np.maximum(frame, self._lowest), self._highest) * self._scale
        frame = np.clip(frame, *self.observation_clip)[:, None]
        if count := len(self.phases):  # they go on to those of the next step
            low, high, speed = np.resize(self._frequency, 3)
            share = np.minimum(np.linalg.norm(inputs[:, self._told], axis=1) / speed, 1.0)
            turned = self.period * (low + (high - low) * share)[:, None]
            action = np.append(action[:, :-count], action[:, -count:] + turned, axis=1)
        if before is None:
            return Memory(action, np.repeat(frame, self.steps, axis=1))
        return Memory(action, np.concatenate([before[:, 1:], frame], axis=1))

    def read(self, memory: Memory) -> Array:
        """Returns what the network reads, shape (N, n)."""
        return memory.frames[:, self.steps - 1 - self._lags, self._indices]

    def _value(self, kind: str, read: Array, action: Array) -> Array:
        """Returns a term's numbers, shape (N, size)."""
        if kind == "joint_pos":
            return read - self.origin[: len(self.joints)]
        if kind == "last_action":
            return action[:, : len(self.joints)]
        if kind in (*_PHASES, "state"):
            state, turns = np.split(action[:, len(self.joints) :], [len(self.state)], axis=1)
            if self._rest.size:
                is_at_rest = np.linalg.norm(read, axis=1, keepdims=True) < _AT_REST
                turns = np.where(is_at_rest, self._rest, turns)
            angles = 2.0 * np.pi * turns
            values = np.minimum(turns, 1.0), np.cos(angles), np.sin(angles), state
            return values[(*_PHASES, "state").index(kind)]
        if kind == "base_lin_vel":
            return _in_body(read[:, :4], read[:, 4:])
        if kind == "projected_gravity":
            return _in_body(read, np.array([[0.0, 0.0, -1.0]]))
        return read


def nearest_term(name: str = "") -> str:
    """Returns a question that names the term, or another name of one, most like a name."""
    return nearest(name, [*TERMS, *_OTHERS])


def _in_body(rotation: Array, vector: Array) -> Array:
    """Returns vectors of the world in the axes of bodies, for their quaternions (w, x, y, z)."""
    unit = rotation / np.linalg.norm(rotation, axis=1, keepdims=True)
    across = np.cross(unit[:, 1:], vector)
    return np.asarray(vector - 2.0 * unit[:, :1] * across + 2.0 * np.cross(unit[:, 1:], across))
