# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks of a task file that need no model, and that the types of its fields cannot express."""

import re
from collections.abc import Sequence
from math import isfinite

from vgps_ros.core.checks import nearest, quoted
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.settings import with_values
from vgps_ros.simulation.names import OBJECTS, SENSOR_TYPES, listed
from vgps_ros.tasks.schema import (
    CostTerm,
    Followed,
    ObservedEntry,
    Path,
    Record,
    RecordedMotion,
    Sensor,
    TaskFile,
    flattened,
)
from vgps_ros.tasks.yaml_file import Document, Entries, Place

MOST_STEPS = 100_000
_ROUNDING = 1e-6  # relative error up to which a time counts as a whole multiple of another
SOURCE = re.compile(r"cmd_vel/(linear|angular)/[xyz]")
_OF_SENSORS = ("index", "target", "reference", "norm", "width", "terminal", "when")


def check_task_file(task: TaskFile, document: Document) -> None:
    """Checks a task.

    Raises:
        InvalidInputError: an entry contradicts another, or names a file outside the folder.
    """
    _check_times(task, document)
    for name, sensor in task.sensors.items():
        _check_sensor(name, sensor, document)
    for name, command in task.commands.items():
        low, high = command.range
        document.refuse(
            not low < high,
            ("commands", name, "range"),
            f"it is {low:g} to {high:g}, but the second must be larger than the first.",
        )
        document.refuse(
            "/" in name or (command.source is not None and not SOURCE.fullmatch(command.source)),
            ("commands", name),
            "its name must hold no slash, and `from` must be cmd_vel/linear/x, or another field of "
            "a Twist: linear or angular, x, y or z.",
        )
        same = next((o for o, c in task.commands.items() if c.source == command.source), name)
        document.refuse(
            command.source is not None and same != name,
            ("commands", name, "from"),
            f"{same} comes from {command.source} already; each command needs a field of its own.",
        )
    for i, term in enumerate(task.cost):
        _check_term(term, document, ("cost", i))
    for i, entry in enumerate(task.observe):
        if isinstance(entry, ObservedEntry):
            _check_observation(entry, document, ("observe", i))
    for key, limits in (("fallen", task.fallen), ("limits", task.limits)):
        for i, limit in enumerate(limits):
            _check_one_of(limit, ("below", "above", "beyond"), document, (key, i))
    if isinstance(task.begin, RecordedMotion | Path) and task.begin.file is not None:
        document.file(("begin", "file"), task.begin.file)
        document.refuse(
            ("begin", "through") in document.lines,
            ("begin", "through"),
            "a path goes through keyframes or is in a file; leave one of them out.",
        )
    with_values(OptimizerSettings(), Entries(flattened(task.optimizer), document, "optimizer"))


def is_multiple(time: float, unit: float) -> bool:
    """Returns whether a time is a whole multiple of a unit, apart from rounding."""
    ratio = time / unit
    return isfinite(ratio) and abs(ratio - round(ratio)) <= _ROUNDING * min(1.0, ratio)


def _check_times(task: TaskFile, document: Document) -> None:
    period, step = task.control_period, task.changes.option.timestep
    for key, time in (("horizon", task.horizon), ("lookahead", task.lookahead)):
        document.refuse(
            not is_multiple(time, period),
            (key,),
            f"it is {time:g} s, but it must be a multiple of the control_period, {period:g} s.",
        )
    document.refuse(
        step is not None and not is_multiple(period, step),
        ("control_period",),
        f"it is {period:g} s, but it must be a multiple of the simulator's time step, {step} s.",
    )
    fastest = 0.5 / period
    document.refuse(
        task.clock is not None and task.clock.frequency > fastest,
        ("clock", "frequency"),
        f"it is {task.clock.frequency if task.clock else 0.0:g} Hz, but with a control_period of "
        f"{period:g} s it must be at most {fastest:g} Hz, two controls a turn.",
    )
    steps = round((task.horizon + task.lookahead) / period)
    document.refuse(
        steps > MOST_STEPS,
        ("horizon",),
        f"horizon and lookahead have {steps:g} steps, but at most {MOST_STEPS} are taken.",
    )


def _check_term(term: CostTerm, document: Document, place: Place) -> None:
    """Checks a term of the cost: its kind and its file."""
    _check_one_of(term, ("sensor", "control"), document, place)
    if term.sensor is None:
        for key in _OF_SENSORS:
            document.refuse(
                (*place, key) in document.lines,
                (*place, key),
                "this belongs to a term with a sensor; a term of controls has a weight only.",
            )
        names = (term.control,) if isinstance(term.control, str) else term.control or ()
        for i, name in enumerate(names):
            document.refuse(
                name in names[:i],
                (*place, "control", i),
                "this entry stands twice; leave one of them out.",
            )
    document.refuse(
        (*place, "width") in document.lines and term.norm != "smooth_abs",
        (*place, "width"),
        "only smooth_abs has a width; add `norm: smooth_abs`.",
    )
    document.refuse(
        term.pose is not None and term.control is None,
        (*place, "pose"),
        "only a term of controls has a pose; leave it out.",
    )
    several = isinstance(term.target, tuple)
    for i, target in enumerate(term.target if isinstance(term.target, tuple) else (term.target,)):
        if isinstance(target, Followed):
            here = (*place, "target", *((i,) if several else ()))
            _check_one_of(target, ("command", "swing"), document, here)
            document.refuse(
                target.swing is None and (*here, "phase") in document.lines,
                (*here, "phase"),
                "only a swing has a phase; leave it out.",
            )
    if term.reference is not None:
        both = (*place, "target")
        document.refuse(both in document.lines, both, "a term has a target or a reference.")
        document.file((*place, "reference"), term.reference)


def _check_observation(entry: ObservedEntry, document: Document, place: Place) -> None:
    owners = ("joint", "sensor", "joint_positions", "joint_velocities")
    _check_one_of(entry, owners, document, place)
    for key, owner in (("as", "joint"), ("index", "sensor")):
        document.refuse(
            (*place, key) in document.lines and getattr(entry, owner) is None,
            (*place, key),
            f"this belongs beside {owner}; leave it out here.",
        )


def _check_sensor(name: str, sensor: Sensor, document: Document) -> None:
    """Checks that an added sensor has a type of MuJoCo's, and the objects that it needs."""
    place, what = ("sensors", name), f"a {sensor.type}"
    document.refuse(
        sensor.type not in SENSOR_TYPES,
        (*place, "type"),
        f"{quoted(sensor.type)} is no type of sensor; there are {listed(list(SENSOR_TYPES))}."
        f"{nearest(sensor.type, SENSOR_TYPES)}",
    )
    document.refuse("/" in name, place, "a sensor's name must not hold a slash; rename it.")
    kind = SENSOR_TYPES[sensor.type]
    between = kind.mujoco_name.startswith("geom")
    _check_object(sensor, kind.objects, what, document, place)
    if sensor.relative_to is not None:
        here = (*place, "relative_to")
        none = f"{what} measures relative to nothing; leave it out."
        document.refuse(not kind.relative_to, here, none)
        _check_object(sensor.relative_to, kind.relative_to, what, document, here)
    document.refuse(
        between and (sensor.relative_to is None or sensor.cutoff is None),
        place,
        f"{what} needs relative_to and cutoff, the farthest distance seen [m], for example "
        "`relative_to: {geom: wall}, cutoff: 1.0`.",
    )


def _check_object(
    record: Record, kinds: Sequence[str], what: str, document: Document, place: Place
) -> None:
    """Checks that a record names one object, of a kind that fits."""
    allowed = f"one of {', '.join(kinds)}" if kinds else "nothing, since it is of the whole model"
    for kind in OBJECTS:
        document.refuse(
            getattr(record, kind, None) is not None and kind not in kinds,
            (*place, kind),
            f"{what} may name {allowed}, but not {kind}.",
        )
    if kinds:
        _check_one_of(record, kinds, document, place)


def _check_one_of(record: Record, names: Sequence[str], document: Document, place: Place) -> None:
    """Checks that a record has a value for exactly one of some fields."""
    given = [name for name in names if getattr(record, name) is not None]
    document.refuse(
        len(given) != 1,
        place,
        f"exactly one of {', '.join(names)} must be given, but here is "
        f"{' and '.join(given) or 'none'}.",
    )
