# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Adds sensors to a model, of the form that `vgps_ros.tasks.model_schema` declares."""

from collections.abc import Mapping
from typing import Any

import mujoco

from vgps_ros.core.patterns import known
from vgps_ros.simulation.change_error import InvalidChangeError, Place, change_at
from vgps_ros.simulation.sensor_types import DIRECTIONS, SENSOR_TYPES


def add_sensor(spec: mujoco.MjSpec, name: str, sensor: Mapping[str, Any]) -> None:
    """Adds a sensor of one object, which may be relative to another one.

    Args:
        spec: the model.
        name: the sensor's name.
        sensor: its type, its object, such as `body: torso`, and what else it needs.

    Raises:
        InvalidChangeError: the model lacks the object, or has such a sensor already.
    """
    place = ("sensors", name)
    if name in {other.name for other in spec.sensors}:
        raise InvalidChangeError(
            place, "the model has a sensor of this name; use that one, or choose another name."
        )
    kind = SENSOR_TYPES[sensor["type"]]
    added = spec.add_sensor(name=name)
    added.type = getattr(mujoco.mjtSensor, f"mjSENS_{(kind.mujoco_name or sensor['type']).upper()}")
    if kind.objects:
        added.objtype, added.objname = _object(spec, sensor, place)
    if "relative_to" in sensor:
        added.reftype, added.refname = _object(spec, sensor["relative_to"], (*place, "relative_to"))
    if "cutoff" in sensor:
        added.cutoff = sensor["cutoff"]


def check_directions(model: mujoco.MjModel, name: str, sensor: Mapping[str, Any]) -> None:
    """Refuses directions of a body's principal axes, which are hardly ever meant.

    MuJoCo's `body` stands for the body's inertial frame. Its axes are sorted by inertia, so the
    z-axis of a long torso is its long axis, wherever that points.

    Raises:
        InvalidChangeError: a direction is that of principal axes that are not the body's own axes.
    """
    frames = {"relative_to": sensor.get("relative_to", {})}
    if sensor["type"] in DIRECTIONS:
        frames["body"] = sensor
    for key, frame in frames.items():
        body = frame.get("body")
        if body and abs(model.body(body).iquat[0]) < 1 - 1e-9:
            raise InvalidChangeError(
                ("sensors", name, key),
                f"`body: {body}` means its principal axes of inertia, which are turned from its "
                f"own frame; write `xbody: {body}` for the directions of that frame.",
            )


def _object(
    spec: mujoco.MjSpec, record: Mapping[str, Any], place: Place
) -> tuple[mujoco.mjtObj, str]:
    """Returns kind and name of the object that a record names."""
    elements = {
        "body": spec.bodies,
        "xbody": spec.bodies,
        "geom": spec.geoms,
        "site": spec.sites,
        "camera": spec.cameras,
        "joint": spec.joints,
        "tendon": spec.tendons,
        "actuator": spec.actuators,
    }
    kind = next(kind for kind in elements if kind in record)
    names = [element.name for element in elements[kind] if element.name]
    with change_at(*place, kind):
        return getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), known(kind, record[kind], names)
