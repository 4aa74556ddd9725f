# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""MuJoCo's types of sensors, and the objects that they measure; to name them takes no MuJoCo."""

from dataclasses import dataclass

XYZ, WXYZ = tuple("xyz"), tuple("wxyz")
FRAMES = ("body", "xbody", "geom", "site")
OBJECTS = (*FRAMES, "joint", "tendon", "actuator")


@dataclass(frozen=True)
class SensorType:
    """A type of sensor."""

    # Kinds of objects of which it may measure one; none where it measures the model.
    objects: tuple[str, ...]
    parts: tuple[str, ...] = ()  # names of its scalars; empty if it is one
    relative_to: tuple[str, ...] = ()  # kinds of objects that it may measure against
    mujoco_name: str = ""  # its name in MuJoCo's enumeration mjtSensor; empty if that is the same


_SOLIDS = ("geom", "body")
SENSOR_TYPES: dict[str, SensorType] = {
    "touch": SensorType(("site",)),
    **dict.fromkeys(
        ("accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer"),
        SensorType(("site", "xbody"), XYZ),  # at a body's frame it gets a site of its own
    ),
    **dict.fromkeys(
        ("jointpos", "jointvel", "jointlimitpos", "jointlimitvel", "jointlimitfrc"),
        SensorType(("joint",)),
    ),
    "jointactuatorfrc": SensorType(("joint",), mujoco_name="jointactfrc"),
    "ballquat": SensorType(("joint",), WXYZ),
    "ballangvel": SensorType(("joint",), XYZ),
    **dict.fromkeys(
        ("tendonpos", "tendonvel", "tendonlimitpos", "tendonlimitvel", "tendonlimitfrc"),
        SensorType(("tendon",)),
    ),
    "tendonactuatorfrc": SensorType(("tendon",), mujoco_name="tendonactfrc"),
    **dict.fromkeys(("actuatorpos", "actuatorvel", "actuatorfrc"), SensorType(("actuator",))),
    "framequat": SensorType(FRAMES, WXYZ, FRAMES),
    **dict.fromkeys(
        ("framepos", "framexaxis", "frameyaxis", "framezaxis", "framelinvel", "frameangvel"),
        SensorType(FRAMES, XYZ, FRAMES),
    ),
    **dict.fromkeys(("framelinacc", "frameangacc"), SensorType(FRAMES, XYZ)),
    **dict.fromkeys(("subtreecom", "subtreelinvel", "subtreeangmom"), SensorType(("body",), XYZ)),
    "distance": SensorType(_SOLIDS, (), _SOLIDS, "geomdist"),
    "normal": SensorType(_SOLIDS, XYZ, _SOLIDS, "geomnormal"),
    "fromto": SensorType(_SOLIDS, tuple("012345"), _SOLIDS, "geomfromto"),
    **dict.fromkeys(("e_potential", "e_kinetic", "clock"), SensorType(())),
}
# Their frame's directions are what they measure.
DIRECTIONS = ("framequat", "framexaxis", "frameyaxis", "framezaxis")
