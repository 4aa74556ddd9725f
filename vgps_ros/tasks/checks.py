# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks of a task file that need no model, and that the types of its fields cannot express."""

from collections.abc import Sequence
from math import isfinite

from vgps_ros.core.checks import nearest, quoted
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.settings import with_values
from vgps_ros.simulation.names import DIRECTIONS, FRAMES, SENSOR_TYPES, listed, scalar_names
from vgps_ros.tasks.schema import (
    CostTerm,
    Indices,
    Limit,
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
_OF_SENSORS = ("index", "target", "reference", "norm", "width", "terminal")


def check_task_file(task: TaskFile, document: Document) -> None:
    """Checks a task.

    Raises:
        InvalidInputError: an entry contradicts another, or names a file outside the folder.
    """
    _check_times(task, document)
    for name, sensor in task.sensors.items():
        check_sensor(name, sensor, document)
    for i, term in enumerate(task.cost):
        _check_term(term, task, document, ("cost", i))
    for i, entry in enumerate(task.observe):
        _check_observation(entry, task, document, ("observe", i))
    _refuse_repeats(task.observe, document, "observe")
    for key, limits in (("fallen", task.fallen), ("limits", task.limits)):
        for i, limit in enumerate(limits):
            _check_limit(limit, task, document, (key, i))
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
    steps = round((task.horizon + task.lookahead) / period)
    document.refuse(
        steps > MOST_STEPS,
        ("horizon",),
        f"horizon and lookahead have {steps:g} steps, but at most {MOST_STEPS} are taken.",
    )


def _check_term(term: CostTerm, task: TaskFile, document: Document, place: Place) -> None:
    """Checks a term of the cost: its kind, its number of values, its files."""
    check_one_of(term, ("sensor", "control"), document, place)
    if term.sensor is None:
        for key in _OF_SENSORS:
            document.refuse(
                (*place, key) in document.lines,
                (*place, key),
                "this belongs to a term with a sensor; a term of controls has a weight only.",
            )
        names = (term.control,) if isinstance(term.control, str) else term.control or ()
        _refuse_repeats(names, document, *place, "control")
        count = None if "all" in names else len(names)
    else:
        count = scalar_count(term.sensor, term.index, task, document, place)
    document.refuse(
        (*place, "width") in document.lines and term.norm != "smooth_abs",
        (*place, "width"),
        "only smooth_abs has a width; add `norm: smooth_abs`.",
    )
    if term.reference is not None:
        both = (*place, "target")
        document.refuse(both in document.lines, both, "a term has a target or a reference.")
        document.file((*place, "reference"), term.reference)
    for key, values in (("target", term.target), ("weight", term.weight)):
        given = len(values) if isinstance(values, tuple) else count
        document.refuse(
            count is not None and given != count,
            (*place, key),
            f"it has {given} values, but the term has {count}; write one for each, or one for all.",
        )


def _check_observation(
    entry: str | ObservedEntry, task: TaskFile, document: Document, place: Place
) -> None:
    if isinstance(entry, str):
        scalar_count(entry, None, task, document, place)
        return
    owners = ("joint", "sensor", "joint_positions", "joint_velocities")
    check_one_of(entry, owners, document, place)
    for key, owner in (("as", "joint"), ("index", "sensor")):
        document.refuse(
            (*place, key) in document.lines and getattr(entry, owner) is None,
            (*place, key),
            f"this belongs beside {owner}; leave it out here.",
        )
    if entry.sensor is not None:
        scalar_count(entry.sensor, entry.index, task, document, place)


def _check_limit(limit: Limit, task: TaskFile, document: Document, place: Place) -> None:
    check_one_of(limit, ("below", "above", "beyond"), document, place)
    count = scalar_count(limit.sensor, limit.index, task, document, place)
    document.refuse(
        count not in (None, 1),
        place,
        f"the sensor {quoted(limit.sensor)} has {count} parts; pick one by its index.",
    )


def _refuse_repeats(entries: Sequence[object], document: Document, *place: str | int) -> None:
    for i, entry in enumerate(entries):
        document.refuse(
            entry in entries[:i], (*place, i), "this entry stands twice; leave one of them out."
        )


JOINT_SCALARS = ("position", "velocity", "sin", "cos")  # of each hinge and slide
_OBJECTS = (*FRAMES, "joint", "tendon", "actuator")


def check_sensor(name: str, sensor: Sensor, document: Document) -> None:
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
    document.refuse(
        sensor.cutoff is not None and sensor.type in DIRECTIONS,
        (*place, "cutoff"),
        "a direction has no largest value; leave it out.",
    )


def _check_object(
    record: Record, kinds: Sequence[str], what: str, document: Document, place: Place
) -> None:
    """Checks that a record names one object, of a kind that fits."""
    allowed = f"one of {', '.join(kinds)}" if kinds else "nothing, since it is of the whole model"
    for kind in _OBJECTS:
        document.refuse(
            getattr(record, kind, None) is not None and kind not in kinds,
            (*place, kind),
            f"{what} may name {allowed}, but not {kind}.",
        )
    if kinds:
        check_one_of(record, kinds, document, place)


def check_one_of(record: Record, names: Sequence[str], document: Document, place: Place) -> None:
    """Checks that a record has a value for exactly one of some fields."""
    given = [name for name in names if getattr(record, name) is not None]
    document.refuse(
        len(given) != 1,
        place,
        f"exactly one of {', '.join(names)} must be given, but here is "
        f"{' and '.join(given) or 'none'}.",
    )


def scalar_count(
    sensor: str, index: Indices | None, task: TaskFile, document: Document, place: Place
) -> int | None:
    """Returns how many scalars a sensor and an index pick; None if only the model can say."""
    owner, _, part = sensor.rpartition("/")
    with document.at(place):
        if sensor in task.sensors:
            return len(scalar_names(sensor, SENSOR_TYPES[task.sensors[sensor].type].parts, index))
        if owner in task.sensors:
            scalar_names(owner, SENSOR_TYPES[task.sensors[owner].type].parts, part)
        elif not (owner and part in JOINT_SCALARS):
            return None
    document.refuse(
        index is not None, (*place, "index"), f"{quoted(sensor)} is one number; leave it out."
    )
    return 1
