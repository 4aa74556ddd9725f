# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Names in a model: found by patterns such as `*_hip`, and those of the numbers that sensors give.

A sensor's values are named after it: `touch` if there is one, `velocity/x` to `velocity/z` if there
are three, `attitude/w` to `attitude/z` for a quaternion, and `fromto/0`, `fromto/1`, ... otherwise.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from vgps_ros.core.checks import nearest, quoted
from vgps_ros.core.errors import InvalidInputError

_MOST_LISTED = 12


def matching(what: str, pattern: str, names: Sequence[str]) -> list[str]:
    """Returns the names that a pattern matches, in their order.

    Args:
        what: what has these names, such as `joint`.
        pattern: a name, which matches itself alone, or a pattern with *, ? or [abc].
        names: all names. The pattern `*` may match none.

    Raises:
        InvalidInputError: no name matches; the sentence has the names, and the nearest one.
    """
    if pattern in names:
        return [pattern]
    found = [name for name in names if fnmatchcase(name, pattern)]
    if not found and pattern != "*":
        raise _unknown(f"{quoted(pattern)} matches no {what}", pattern, names)
    return found


def known(what: str, name: str, names: Sequence[str]) -> str:
    """Returns a name if it is among the names.

    Raises:
        InvalidInputError: it is not; the sentence has the names, and the nearest one.
    """
    if name not in names:
        raise _unknown(f"there is no {what} {quoted(name)}", name, names)
    return name


def listed(names: Sequence[str]) -> str:
    """Returns the first of some names, as a sentence lists them."""
    shown = ", ".join(quoted(name).strip("'") for name in names[:_MOST_LISTED])
    return f"{shown} and others" if len(names) > _MOST_LISTED else shown or "none"


def _unknown(complaint: str, name: str, names: Sequence[str]) -> InvalidInputError:
    return InvalidInputError(f"{complaint}; there are {listed(names)}.{nearest(name, names)}")


XYZ, WXYZ = tuple("xyz"), tuple("wxyz")
FRAMES = ("body", "xbody", "geom", "site", "camera")
OBJECTS = (*FRAMES, "joint", "tendon", "actuator")


@dataclass(frozen=True)
class SensorType:
    """A type of sensor.

    Attributes:
        objects: kinds of objects of which it may measure one; none where it measures the model.
        parts: names of its scalars; empty if it is one.
        relative_to: kinds of objects that it may measure against.
        mujoco_name: its name in MuJoCo's enumeration mjtSensor; empty if that is the same.
    """

    objects: tuple[str, ...]
    parts: tuple[str, ...] = ()
    relative_to: tuple[str, ...] = ()
    mujoco_name: str = ""


_SOLIDS = ("geom", "body")
SENSOR_TYPES: dict[str, SensorType] = {
    "touch": SensorType(("site",)),
    **dict.fromkeys(
        ("accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer"),
        SensorType(("site",), XYZ),
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


def scalar_names(
    sensor: str, parts: tuple[str, ...], index: str | int | Iterable[str | int] | None = None
) -> list[str]:
    """Returns the full names of a sensor's scalars, such as `velocity/x`.

    Args:
        sensor: its name.
        parts: names of its parts; empty for a scalar.
        index: the part or parts to return, by name or by number from 0; all if it is None.

    Raises:
        InvalidInputError: the sensor has no such part.
    """
    if index is None:
        return [f"{sensor}/{part}" for part in parts] or [sensor]
    if not parts:
        raise InvalidInputError(f"the sensor {quoted(sensor)} is one number; leave its index out.")
    found = []
    for wanted in [index] if isinstance(index, str | int) else index:
        part = str(wanted)
        if isinstance(wanted, int) and 0 <= wanted < len(parts):
            part = parts[wanted]
        if part not in parts:
            raise InvalidInputError(
                f"the sensor {quoted(sensor)} has the parts {', '.join(parts)}, but not "
                f"{quoted(wanted)}.{nearest(part, parts)}"
            )
        found.append(f"{sensor}/{part}")
    return found
