# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Builds a task from a task file and the robot's MJCF."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import msgspec
import mujoco
import numpy as np

from vgps_ros.core.augmentation import Augmentation, Mirror
from vgps_ros.core.checks import find_name, matching_names, quote
from vgps_ros.core.cost import FeatureCost, Following
from vgps_ros.core.errors import Place, at_entry, refuse_if
from vgps_ros.core.memory import LAST_ACTION, PastInputs, reading_of
from vgps_ros.core.observation import Observation
from vgps_ros.core.records import Array
from vgps_ros.robot.deployment import Conditions
from vgps_ros.robot.signals import CLOCK, Command, Signals
from vgps_ros.simulation.controls import resting_controls
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import (
    compile_model,
    deviation_names,
    joint_names,
    scalar_names,
    sensor_numbers,
    try_model,
)
from vgps_ros.simulation.model_changes import changed_spec, self_contained
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks.first_motion import RandomControls, keyframe, pose_data, with_beginning
from vgps_ros.tasks.schema import (
    Changes,
    CostTerm,
    Followed,
    Limit,
    MirrorEntry,
    ObservedEntry,
    SpreadLimit,
    Stance,
    Start,
    StateSpread,
    TaskFile,
)
from vgps_ros.tasks.task import Task
from vgps_ros.tasks.task_file import Document, find_model, is_multiple, read_task_file, settings_in


def load_task(path: Path, name: str) -> Task:
    """Returns the task that a file, or that in a folder, describes, under a name.

    Raises:
        InvalidInputError: an entry is wrong; the message has its line.
    """
    file, document = read_task_file(path)
    with document.name_lines():
        return _build(file, document, name)


def _build(file: TaskFile, document: Document, name: str) -> Task:
    mjcf = _model_text(file, document)
    # The text may round the model's numbers, so all compile the same text: nodes, checks and this.
    model = compile_model(mjcf, is_tried=True)
    with at_entry("model"):
        dynamics = Dynamics(model, round(file.control_period / model.opt.timestep))
    signals, std = _signals(file), file.start.std
    refuse_if(
        signals.stops and state_layout(model).base is None,
        "only a robot on a free base feels when it has to step again; leave it out.",
        "clock",
        "stops",
    )
    times = file.horizon, file.lookahead  # each of whole control periods
    steps = [math.ceil(time / file.control_period * (1.0 - 1e-9)) for time in times]
    context = signals.constant_context(signals.nominal, sum(steps))
    read = _Reader(dynamics, signals, context)
    with at_entry("start"):
        start = _start_state(file.start, model)
    cost, observation = _cost(file, read, start), read.observation(file, start)
    optimizer, search = settings_in(file, document)
    task = Task(
        name=name,
        mjcf=mjcf,
        dynamics=dynamics,
        cost=cost,
        horizon=steps[0],
        lookahead=steps[1],
        initial_state=start,
        initial_std=read.by_coordinate(std, ("start", "std")),
        varied_state_std=read.by_coordinate(file.start.varied or std, ("start", "varied")),
        std_limit=read.by_coordinate(file.marginals.std_limit, ("marginals", "std_limit")),
        observation=observation,
        begin=RandomControls(),  # until the rest is there
        fallen=read.conditions(file.fallen, "fallen"),
        limits=read.conditions(file.limits, "limits"),
        optimizer=optimizer,
        search=search,
        signals=signals,
        context=context if signals.names else None,
        augmentation=read.augmentation(file, observation),
    )
    with at_entry("begin"):
        return with_beginning(task, file.begin, document.folder)


def _signals(file: TaskFile) -> Signals:
    """Returns the commands and the clock of a file."""
    commands = (
        Command(name, *entry.range, source=entry.source or "", unit=entry.unit)
        for name, entry in file.commands.items()
    )
    if file.clock is None:
        return Signals(tuple(commands), 0.0, file.control_period)
    clock = file.clock
    return Signals(tuple(commands), clock.frequency, file.control_period, clock.stops)


class _Reader:
    """Finds what entries of the file name in the model."""

    def __init__(self, dynamics: Dynamics, signals: Signals, context: Array):
        self.dynamics, self.signals, self.context = dynamics, signals, context
        self.model: mujoco.MjModel = dynamics.model
        self.joints = joint_names(self.model)

    def readings(self, names: Sequence[str]) -> Readings:
        """Returns the readings of these names."""
        return Readings(self.dynamics.simulations, names)

    def names(self, sensor: str, index: Any) -> list[str]:
        """Returns the full names of the numbers that a sensor and an index pick."""
        numbers = sensor_numbers(self.model)
        prefix = f"{sensor}/"
        parts = [name.removeprefix(prefix) for name in numbers if name.startswith(prefix)]
        if sensor in numbers or not parts:  # a scalar by its full name, or an unknown one
            self.readings([sensor])
            parts = []
        with at_entry("index"):
            return scalar_names(sensor, tuple(parts), index)

    def conditions(self, limits: Sequence[Limit], key: str) -> Conditions:
        """Returns the limits that the entry `key` lists, one number each."""
        names, low, high = [], [], []
        for i, limit in enumerate(limits):
            with at_entry(key, i):
                found = self.names(limit.sensor, limit.index)
                refuse_if(
                    len(found) != 1, f"it has the parts {', '.join(found)}; pick one by its index."
                )
            names += found
            beyond = np.inf if limit.beyond is None else limit.beyond
            low.append(0.0 - beyond if limit.below is None else limit.below)
            high.append(beyond if limit.above is None else limit.above)
        with at_entry(key):
            return Conditions(self.readings(names), np.array(low), np.array(high))

    def observation(self, file: TaskFile, start: Array) -> Observation:
        """Returns what the policy reads: of the state, of former steps, of commands and clock."""
        entries, names = file.observe, list[str]()
        told = [
            name
            for entry in ("commands", "clock")
            if entry in entries
            for name in self._told(entry)
        ]
        for i, entry in enumerate(entries):
            with at_entry("observe", i):
                if entry in ("commands", "clock", LAST_ACTION):
                    refuse_if(entry in entries[:i], f"{entry} is read twice; leave it out.")
                    refuse_if(
                        entry != LAST_ACTION and not self._told(entry),
                        f"the task has no {entry}; leave it out, or add it.",
                    )
                    continue
                for name in self._observed(entry):
                    refuse_if(name in names, f"{quote(name)} is read twice; leave it out.")
                    names.append(name)
        with at_entry("observe"):
            refuse_if(
                not names,
                "the policy reads nothing; name the readings of joints or sensors that it needs.",
            )
            readings = self.readings(names)
            refuse_if(
                readings.needs_controls,
                "a sensor of forces or accelerations depends on the control that the policy has "
                "yet to choose; read positions and velocities.",
            )
        observation = Observation.of(readings, told, self.signals.names).within(self.context)
        if not (file.history or LAST_ACTION in entries):
            return observation
        controls = self.dynamics.controls
        actions = controls.names if LAST_ACTION in entries else ()
        rest, limits = controls.resting(start), controls.limits
        past = PastInputs(tuple(names), file.history, tuple(actions), rest, limits)
        return replace(observation, past=past)

    def augmentation(self, file: TaskFile, observation: Observation) -> Augmentation | None:
        """Returns the noise and the mirror of a file; None where it has neither."""
        if not file.sensor_noise and file.mirror is None:
            return None
        names, read = list(observation.names), list(observation.readings.names)
        of_readings: dict[str, float] = {}
        for pattern, std in file.sensor_noise.items():
            with at_entry("sensor_noise", pattern):
                of_readings |= dict.fromkeys(matching_names("reading", pattern, read), std)
        noise = np.array([of_readings.get(reading_of(name), 0.0) for name in names])
        locked = [name for name, values in file.changes.joints.items() if values.lock is not None]
        with at_entry("mirror"):
            mirror = self._mirror(file.mirror, names, locked) if file.mirror else None
        return Augmentation(noise, mirror)

    def _mirror(self, entry: MirrorEntry, names: list[str], locked: list[str]) -> Mirror:
        """Returns the exchange of left and right of what is read, and of the actuators.

        What is flipped may be a joint that is locked, and so is read no longer.
        """
        actuators = [self.model.actuator(i).name for i in range(self.model.nu)]
        # What a number is of, by whose name it is flipped.
        of = {name: reading_of(name) for name in [*names, *actuators]}
        driven = zip(self.dynamics.controls.names, actuators, strict=True)
        last = {f"{LAST_ACTION}/{joint}": actuator for joint, actuator in driven}
        of |= {name: last[name] for name in names if name in last}
        signs: dict[str, float] = dict.fromkeys(of, 1.0)
        for pattern in entry.flip:
            found = [
                name
                for name, own in of.items()
                if fnmatchcase(own, pattern) or fnmatchcase(own.rpartition("/")[0], pattern)
            ]
            refuse_if(
                not found and not any(fnmatchcase(pattern, lock) for lock in locked),
                f"{quote(pattern)} is no name or pattern of a reading or an actuator.",
                "flip",
            )
            signs |= dict.fromkeys(found, -1.0)

        def places(among: list[str]) -> list[int]:
            found = []
            for name in among:
                other = swap_parts(name, entry.swap)
                refuse_if(
                    other not in among or signs[other] != signs[name],
                    f"the mirror image of {name} would be {other}, which is not there, or has "
                    "another sign.",
                )
                found.append(among.index(other))
            return found

        return Mirror(
            np.array(places(names)),
            np.array([signs[name] for name in names]),
            np.array(places(actuators)),
            np.array([signs[name] for name in actuators]),
        )

    def _told(self, entry: str) -> list[str]:
        """Returns the numbers of the context that commands, or clock, stand for."""
        prefix = {"commands": "command/", "clock": "clock/"}[entry]
        return [name for name in self.signals.names if name.startswith(prefix)]

    def _observed(self, entry: str | ObservedEntry) -> list[str]:
        if isinstance(entry, str):
            kind = {"joint_positions": "position", "joint_velocities": "velocity"}.get(entry)
            if kind is None:
                return self.names(entry, None)
            return [f"{joint}/{kind}" for joint in self.joints]
        if entry.sensor is not None:
            return self.names(entry.sensor, entry.index)
        if entry.joint is not None:
            forms = {"sin_cos": ("sin", "cos")}.get(entry.form, (entry.form,))
            joints = matching_names("hinge or slide", entry.joint, self.joints)
            return [f"{joint}/{form}" for joint in joints for form in forms]
        kind = "position" if entry.joint_positions else "velocity"
        excluded = entry.joint_positions or entry.joint_velocities
        out = {
            joint
            for pattern in (excluded.excluded if excluded else ())
            for joint in matching_names("hinge or slide", pattern, self.joints)
        }
        return [f"{joint}/{kind}" for joint in self.joints if joint not in out]

    def by_coordinate(self, spread: StateSpread | SpreadLimit, place: Place) -> Array:
        """Returns a value for each coordinate of a deviation, shape (n_dx,)."""
        names, n_v = deviation_names(self.model), self.model.nv
        of_activation = np.inf if isinstance(spread, SpreadLimit) else 0.0
        counts = (n_v, n_v, self.model.na)
        values = np.repeat([spread.position, spread.velocity, of_activation], counts)
        for pattern, value in spread.overrides.items():
            with at_entry(*place, "overrides", pattern):
                for name in matching_names("coordinate", pattern, names):
                    values[names.index(name)] = value
        return values


def _cost(file: TaskFile, read: _Reader, start: Array) -> FeatureCost:
    """Returns the cost, whose readings are the parts of all terms of sensors, one after another."""
    steps, names = len(read.context), list[str]()
    targets, weights, smooth = [], [], []
    linear, lifted, stance, whens = [], [], [], []
    controls, poses = np.zeros((2, read.model.nu))
    for i, term in enumerate(file.cost):
        with at_entry("cost", i):
            if term.control is not None:
                _add_controls(controls, poses, term, read, start)
                continue
            assert term.sensor is not None
            found = read.names(term.sensor, term.index)
            names += found
            size = len(found)
            weights.append(np.ones((steps, 1)) * _each(term.weight, size, "weight"))
            parts = _parts(term.target, size, "target")
            target = np.array([p.rest if isinstance(p, Followed) else p for p in parts], float)
            with at_entry("target"):
                follow = [_following(part, read) for part in parts]
            refuse_if(
                isinstance(term.when, str) and not read.signals.commands,
                "the task has no command that could be at rest or not; add one.",
                "when",
            )
            whens += [term.when] * size
            down: float | Followed = 0.0
            if isinstance(term.when, Stance):
                down = Followed(swing=-1.0, phase=term.when.stance)
            with at_entry("when"):
                stance += [_following(down, read)[1]] * size
            linear += [a for a, _ in follow]
            lifted += [b for _, b in follow]
            targets.append(np.broadcast_to(target, (steps, size)))
            smooth.append(np.full(size, term.width if term.norm == "smooth_abs" else 0.0))
    for i, command in enumerate(read.signals.commands):
        refuse_if(
            not any(row[i] for row in linear),
            "no cost reads it, so that nothing is learned of it; let the target of a term follow "
            f"it, as in `target: {{command: {command.name}}}`, or leave it out.",
            "commands",
            command.name,
        )
    following = None
    if np.any([*linear, *lifted]) or any(whens):
        following = Following(
            np.array(linear),
            np.array(lifted),
            moving=np.array([float(when != "still") for when in whens]),
            still=np.array([float(when != "moving") for when in whens]),
            stance=np.array(stance),
            rest=read.signals.rest,
        )
    with at_entry("cost"):
        features = read.readings(names)
    return FeatureCost(
        features=features,
        targets=_join_columns(targets, steps),
        weights=_join_columns(weights, steps),
        smooth=np.concatenate([np.empty(0), *smooth]),
        control_weights=controls,
        control_targets=poses,
        following=following,
        context=read.context if following else None,
    )


def _following(target: float | Followed, read: _Reader) -> tuple[Array, Array]:
    """Returns how a target follows the context: its rows of A and B in `core.cost.Following`."""
    names = read.signals.names
    linear, lifted = np.zeros((2, len(names)))
    if not isinstance(target, Followed):
        return linear, lifted
    if target.command is not None:
        commands = [command.name for command in read.signals.commands]
        with at_entry("command"):
            find_name("command", target.command, commands)
        linear[names.index(f"command/{target.command}")] = 1.0
    else:
        assert target.swing is not None
        refuse_if("clock/sin" not in names, "the task has no clock that it could follow; add one.")
        angle = 2.0 * np.pi * target.phase  # sin(2πφ + angle), by the sine and cosine of 2πφ
        wave = target.swing * np.array([np.cos(angle), np.sin(angle)])
        lifted[[names.index(name) for name in CLOCK]] = wave
    return linear, lifted


def _add_controls(
    weights: Array, poses: Array, term: CostTerm, read: _Reader, start: Array
) -> None:
    """Adds a term's weight of each control, and sets the pose from which it counts."""
    actuators = [read.model.actuator(i).name for i in range(read.model.nu)]
    given = (term.control,) if isinstance(term.control, str) else term.control or ()
    with at_entry("control"):
        chosen = [
            name
            for pattern in given
            for name in matching_names("actuator", "*" if pattern == "all" else pattern, actuators)
        ]
    each = _each(term.weight, len(chosen), "weight")
    for name, weight in zip(chosen, each, strict=True):
        weights[actuators.index(name)] += weight
    if term.pose is not None:
        with at_entry("pose"):
            data = pose_data(read.model, start, term.pose)
        held = resting_controls(data)
        for name in chosen:
            poses[actuators.index(name)] = held[actuators.index(name)]


def _parts(values: Any, size: int, key: str) -> list[Any]:
    """Returns one value for each of some numbers, `size` of them."""
    found = list(values) if isinstance(values, tuple) else [values]
    refuse_if(
        len(found) not in (1, size),
        f"it has {len(found)} values, but the term has {size} numbers.",
        key,
    )
    return found if len(found) == size else found * size


def _each(values: Any, size: int, key: str) -> Array:
    """Returns one value for each of some numbers, shape (size,)."""
    return np.array(_parts(values, size, key), dtype=float)


def _join_columns(columns: Iterable[Array], steps: int) -> Array:
    """Returns columns side by side, (T, m), or their first row (m,) where they never change."""
    values = np.concatenate([np.empty((steps, 0)), *columns], axis=1)
    return values[0] if (values == values[0]).all() else values


def _model_text(task: TaskFile, document: Document) -> str:
    """Returns the model with its changes and sensors as one MJCF text that needs no other file.

    It is the robot's own text where that can stand as it is, since to write it anew rounds the
    orientation of its inertias in the last bits. Another process makes it, but of a built-in task.
    """
    path, changes = find_model(task.model, document.folder), msgspec.to_builtins(task.changes)

    def texts() -> Iterator[str]:
        with document.name_lines():  # here, since of an error only its sentence comes back
            spec = changed_spec(path, changes, msgspec.to_builtins(task.sensors))
            step = spec.option.timestep
            refuse_if(
                not is_multiple(task.control_period, step),
                f"it is {task.control_period:g} s, but it must be a multiple of the model's time "
                f"step, {step:g} s.",
                "control_period",
            )
            are_moved = _move_mocap(spec, task.start)
            if task.changes == Changes() and not task.sensors and not are_moved:
                with suppress(UnicodeDecodeError):
                    yield path.read_text()
            with at_entry("model"):
                yield self_contained(spec)

    return next(texts()) if path.is_relative_to(Path(__file__).parent) else try_model(texts)


_LAGGING = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)


def _move_mocap(spec: mujoco.MjSpec, start: Start) -> bool:
    """Moves mocap bodies, which are no part of a state, to where the start's keyframe has them.

    Returns whether there are any.
    """
    if start.keyframe is None or not any(body.mocap for body in spec.bodies):
        return False
    model = spec.compile()
    with at_entry("start", "keyframe"):
        key = keyframe(model, start.keyframe)
    for i in np.flatnonzero(model.body_mocapid >= 0):
        body, place = spec.body(model.body(i).name), model.body_mocapid[i]
        body.set_frame(body.parent.add_frame())  # an even one, since its place counts all
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.pos = model.key_mpos[key].reshape(-1, 3)[place]
        body.quat = model.key_mquat[key].reshape(-1, 4)[place]
    return True


def _start_state(start: Start, model: mujoco.MjModel) -> Array:
    """Returns the mean of x_1, shape (n_x,).

    An actuator that lags has followed the control of a keyframe that says nothing of activations.
    """
    data = mujoco.MjData(model)
    if start.keyframe is not None:
        with at_entry("keyframe"):
            mujoco.mj_resetDataKeyframe(model, data, keyframe(model, start.keyframe))
        lagging = np.flatnonzero(np.isin(model.actuator_dyntype, _LAGGING))
        if not data.act.any():
            data.act[model.actuator_actadr[lagging]] = data.ctrl[lagging]
    names = [model.joint(i).name for i in range(model.njnt)]
    for key, values, addresses in (
        ("positions", data.qpos, model.jnt_qposadr),
        ("velocities", data.qvel, model.jnt_dofadr),
    ):
        for name, given in getattr(start, key).items():
            with at_entry(key, name):
                i = names.index(find_name("joint", name, names))
                end = [*addresses[1:], len(values)][i]
                numbers, size = np.atleast_1d(np.array(given, dtype=float)), end - addresses[i]
                refuse_if(
                    numbers.size != size,
                    f"{quote(name)} has {size} numbers, but {numbers.size} are given.",
                )
            values[addresses[i] : end] = numbers
    mujoco.mj_normalizeQuat(model, data.qpos)
    return np.concatenate([data.qpos, data.qvel, data.act])


_SHORT = 2  # letters of a part, such as l or FR, that may stand in any word by chance


def swap_parts(name: str, pairs: Sequence[tuple[str, str]]) -> str:
    """Returns a name with the parts of each pair swapped.

    Short parts and numbers count only where they are words of their own, as in l_hip, hipL or leg2.
    """
    for one, other in pairs:
        both = {one: other, other: one}
        part = re.compile("|".join(map(_part, sorted(both, key=len, reverse=True))))
        rest, images = part.split(name), [both[each] for each in part.findall(name)]
        name = "".join(a + b for a, b in zip(rest, [*images, ""], strict=True))
    return name


def _part(part: str) -> str:
    """Returns the regular expression that finds a part of a name."""
    if len(part) > _SHORT and not part.isdigit():
        return re.escape(part)
    kind = r"\d" if part.isdigit() else "A-Z" if part.isupper() else "A-Za-z"
    after = r"\d" if part.isdigit() else "a-z"
    return f"(?<![{kind}]){re.escape(part)}(?![{after}])"
