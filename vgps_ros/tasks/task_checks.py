# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks of a task file that need no model, and that the types of its fields cannot express."""

from collections.abc import Sequence
from math import isfinite

from vgps_ros.core.checks import quoted
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.settings import with_values
from vgps_ros.tasks.document import Document, Entries, Place
from vgps_ros.tasks.reading_schema import CostTerm, Limit, Observation
from vgps_ros.tasks.sensor_checks import check_one_of, check_sensor, scalar_count
from vgps_ros.tasks.task_schema import Demonstration, Path, TaskFile, flattened

MOST_STEPS = 100_000
_ROUNDING = 1e-6  # relative error up to which a time counts as a whole multiple of another
_OF_SENSORS = ("index", "target", "reference", "norm", "width", "terminal")


def check_task(task: TaskFile, document: Document) -> None:
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
    if isinstance(task.begin, Demonstration | Path) and task.begin.file is not None:
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
    entry: str | Observation, task: TaskFile, document: Document, place: Place
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
