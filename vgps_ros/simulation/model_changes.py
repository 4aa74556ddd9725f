# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Changes a robot's model in memory, through MuJoCo's MjSpec; the file itself is never edited.

Changes are plain data, of the form that `vgps_ros.tasks.model_schema` declares. They are made in
this order: a floor is added, actuators are removed, options set, joints and geoms changed, contacts
restricted, motors and sensors added. Bodies, joints, geoms and actuators without a name get one
first, so that changes and tasks can name them: a body after the one that carries it, a joint or
geom after its body (`trunk_free`, `foot_geom`), an actuator after what it drives.
"""

import warnings
from collections.abc import Mapping, Sequence
from itertools import chain, count
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.checks import one_of, quoted
from vgps_ros.core.patterns import matching
from vgps_ros.simulation.added_sensors import add_sensor, check_directions
from vgps_ros.simulation.change_error import InvalidChangeError, Place, change_at
from vgps_ros.simulation.text_limits import excess_of_file

Values = Mapping[str, Any]

_ERRORS = (ValueError, mujoco.FatalError)  # of a model that does not compile
_SCALAR_JOINTS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_WORDS = {  # options that are words, with MuJoCo's enumerations of them
    "integrator": (mujoco.mjtIntegrator, "mjINT_"),
    "solver": (mujoco.mjtSolver, "mjSOL_"),
    "cone": (mujoco.mjtCone, "mjCONE_"),
    "jacobian": (mujoco.mjtJacobian, "mjJAC_"),
}
_FLAGS = {
    "disable": ("disableflags", mujoco.mjtDisableBit, "mjDSBL_"),
    "enable": ("enableflags", mujoco.mjtEnableBit, "mjENBL_"),
}
_LIMITED = {"range": "limited", "actfrcrange": "actfrclimited"}


def changed_spec(path: Path, changes: Values, sensors: Mapping[str, Values]) -> mujoco.MjSpec:
    """Returns a model with changes and sensors; it is known to compile.

    Args:
        path: its MJCF.
        changes: the changes, see above.
        sensors: sensors to add, by name.

    Raises:
        InvalidChangeError: the model does not compile, or a change does not suit it.
    """
    if excess := excess_of_file(path):
        raise InvalidChangeError(("model",), excess)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except _ERRORS as error:
        raise InvalidChangeError(("model",), f"the model is no valid MJCF: {error}.") from error
    name_all(spec)
    if changes.get("floor"):
        _add_floor(spec)
    for i, pattern in enumerate(changes.get("remove_actuators", ())):
        for actuator in _matching(spec.actuators, "actuator", pattern, "remove_actuators", i):
            spec.delete(actuator)
    _set_option(spec.option, changes.get("option", {}))
    for kind, elements in (("joint", spec.joints), ("geom", spec.geoms)):
        for pattern, values in changes.get(f"{kind}s", {}).items():
            for element in _matching(elements, kind, pattern, f"{kind}s", pattern):
                _change(spec, element, values, ("changes", f"{kind}s", pattern))
    if "only_contacts" in changes:
        _restrict_contacts(spec, changes["only_contacts"])
    for name, motor in changes.get("actuators", {}).items():
        _add_motors(spec, name, motor)
    if "remove_actuators" in changes or "actuators" in changes:
        _drop_references(spec, changes)
    for name, sensor in sensors.items():
        add_sensor(spec, name, sensor)
    model = _compiled(spec, path)
    for name, sensor in sensors.items():
        check_directions(model, name, sensor)
    return spec


def _add_floor(spec: mujoco.MjSpec) -> None:
    """Adds a plane that is as large as it has to be, and drawn in grey."""
    if spec.geom("floor") is not None:
        raise InvalidChangeError(
            ("changes", "floor"), "the model has a geom of this name already; leave floor out."
        )
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name="floor", type=plane, size=[0, 0, 1], rgba=[0.8, 0.8, 0.8, 1])


def _compiled(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    try:
        with warnings.catch_warnings():  # of old words in somebody's file, which nobody here edits
            warnings.simplefilter("ignore")
            return spec.compile()
    except _ERRORS as error:
        place = "changes"
        try:
            mujoco.MjSpec.from_file(str(path)).compile()
        except _ERRORS:
            place = "model"
        raise InvalidChangeError((place,), f"the model does not compile: {error}.") from error


def name_all(spec: mujoco.MjSpec) -> None:
    """Names each body, joint, geom and actuator that has no name; a parent comes before its own."""
    for elements in (spec.bodies, spec.joints, spec.geoms, spec.actuators):
        taken = {element.name for element in elements}
        for element in elements:
            if not element.name:
                name = _natural_name(element)
                candidates = chain([name], (f"{name}_{number}" for number in count(2)))
                element.name = next(each for each in candidates if each not in taken)
                taken.add(element.name)


def _natural_name(element: Any) -> str:
    if isinstance(element, mujoco.MjsActuator):
        return element.target or "actuator"
    kind = "body" if isinstance(element, mujoco.MjsBody) else "geom"
    if isinstance(element, mujoco.MjsJoint):
        kind = mujoco.mjtJoint(element.type).name.removeprefix("mjJNT_").lower()
    return kind if element.parent.name == "world" else f"{element.parent.name}_{kind}"


def _matching(elements: Sequence[Any], what: str, pattern: str, *place: str | int) -> list[Any]:
    """Returns the elements whose names a pattern matches; `place` is that of the pattern."""
    by_name = {element.name: element for element in elements}
    with change_at("changes", *place):
        return [by_name[name] for name in matching(what, pattern, list(by_name))]


def _set_option(option: Any, values: Values) -> None:
    for name, value in values.items():
        if name in _FLAGS:
            field, bits, prefix = _FLAGS[name]
            known = [bit.removeprefix(prefix).lower() for bit in bits.__members__ if prefix in bit]
            for i, word in enumerate(value):
                with change_at("changes", "option", name, i):
                    bit = getattr(bits, prefix + one_of("flag", word, known).upper())
                setattr(option, field, getattr(option, field) | int(bit))
        elif name in _WORDS:
            words, prefix = _WORDS[name]
            setattr(option, name, int(getattr(words, prefix + value.upper())))
        else:
            setattr(option, name, value)


def _change(spec: mujoco.MjSpec, element: Any, values: Values, place: Place) -> None:
    """Sets fields of a joint or geom; a list shorter than the field leaves the rest as it is."""
    for name, value in values.items():
        field = getattr(element, name)
        in_degrees = spec.compiler.degree and element.type == mujoco.mjtJoint.mjJNT_HINGE
        if name in ("range", "springref") and in_degrees:
            field_value = np.degrees(value)
        else:
            field_value = int(value) if isinstance(value, bool) else value
        if name in _LIMITED:
            setattr(element, _LIMITED[name], int(values.get(_LIMITED[name], True)))
        if not isinstance(field, np.ndarray):
            setattr(element, name, field_value)
        elif np.size(value) <= len(field):
            field[: np.size(value)] = field_value
        else:
            raise InvalidChangeError(
                (*place, name),
                f"it has {np.size(value)} values, but at most {len(field)} are taken.",
            )


def _restrict_contacts(spec: mujoco.MjSpec, pairs: Sequence[Sequence[str]]) -> None:
    """Lets only pairs of geoms touch: pair i has bit i of one's contype and other's conaffinity.

    Pairs are not written as MuJoCo's explicit ones, since those take none of their geoms' softness
    and friction.
    """
    bits = {geom.name: [0, 0] for geom in spec.geoms}
    for i, pair in enumerate(pairs):
        for side, pattern in enumerate(pair):
            for geom in _matching(spec.geoms, "geom", pattern, "only_contacts", i, side):
                bits[geom.name][side] |= 1 << i
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = bits[geom.name]
    for explicit in spec.pairs:
        (a, b), (c, d) = bits[explicit.geomname1], bits[explicit.geomname2]
        if not (a & d or b & c):
            spec.delete(explicit)


def _add_motors(spec: mujoco.MjSpec, key: str, motor: Values) -> None:
    """Adds a motor to a joint, or to each hinge and slide that a pattern matches."""
    pattern, limit, place = motor["joint"], motor.get("limit"), ("changes", "actuators", key)
    joints = [
        joint
        for joint in _matching(spec.joints, "joint", pattern, *place[1:], "joint")
        if joint.type in _SCALAR_JOINTS
    ]
    if not joints:
        raise InvalidChangeError(
            (*place, "joint"),
            f"{quoted(pattern)} is neither a hinge nor a slide, but a motor drives only those.",
        )
    for joint in joints:
        name = key if joint.name == pattern else joint.name
        if name in {actuator.name for actuator in spec.actuators}:
            raise InvalidChangeError(
                place,
                f"the model has an actuator {quoted(name)}; remove it by remove_actuators first.",
            )
        actuator = spec.add_actuator(name=name, target=joint.name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.set_to_motor()
        actuator.gear = [motor.get("gear", 1.0), 0, 0, 0, 0, 0]
        # The model's defaults of actuators must not limit it.
        actuator.ctrllimited, actuator.forcelimited = int(limit is not None), 0
        actuator.ctrlrange = [-limit, limit] if limit is not None else [0, 0]


def _drop_references(spec: mujoco.MjSpec, changes: Values) -> None:
    """Removes what referred to the former actuators: keyframes' controls, and sensors."""
    names = {actuator.name for actuator in spec.actuators}
    for key in spec.keys:
        key.ctrl = []
        if "remove_actuators" in changes:  # added motors have no activations
            key.act = []
    for sensor in spec.sensors:
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname not in names:
            spec.delete(sensor)
