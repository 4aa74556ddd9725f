# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks of the sensors that a task file adds, and of the scalars that it reads from sensors."""

from collections.abc import Sequence

from vgps_ros.core.checks import nearest, quoted
from vgps_ros.core.patterns import listed
from vgps_ros.simulation.sensor_types import DIRECTIONS, FRAMES, SENSOR_TYPES, scalar_names
from vgps_ros.tasks.document import Document, Place
from vgps_ros.tasks.model_schema import Sensor
from vgps_ros.tasks.reading_schema import Indices
from vgps_ros.tasks.schema_types import Record
from vgps_ros.tasks.task_schema import TaskFile

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
