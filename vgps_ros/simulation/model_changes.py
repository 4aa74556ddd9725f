# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Changes a robot's model in memory, through MuJoCo's MjSpec; the file itself is never edited.

Changes and added sensors are plain data, of the form that `vgps_ros.tasks.schema` declares. They
are made in this order: what only shows is dropped, a floor is added, actuators and bodies are
removed, options set, joints, geoms and masses changed, contacts restricted, motors added, joints
locked with what drives them, bodies freed, and sensors added. Bodies, joints, geoms and
actuators without a name get one first, so that changes and tasks can name them: a body after the
one that carries it, a joint or geom after its body (`trunk_free`, `foot_geom`), an actuator after
what it drives.
"""

import warnings
from collections.abc import Mapping, Sequence
from itertools import chain, count
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.checks import error_text, find_name, matching_names, quote
from vgps_ros.core.errors import InvalidEntryError, InvalidInputError, Place, at_entry
from vgps_ros.simulation.model import MUJOCO_ERRORS
from vgps_ros.simulation.model_file import read_model
from vgps_ros.simulation.sensor_types import DIRECTIONS, OBJECTS, SENSOR_TYPES

Values = Mapping[str, Any]

_SCALAR_JOINTS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_POSITIONS = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}  # of others 1
_WORDS = {  # options that are words, with MuJoCo's enumerations of them
    "integrator": (mujoco.mjtIntegrator, "mjINT_"),
    "solver": (mujoco.mjtSolver, "mjSOL_"),
    "cone": (mujoco.mjtCone, "mjCONE_"),
}
_LIMITED = {"range": "limited", "actfrcrange": "actfrclimited"}  # which a range switches on


def changed_spec(path: Path, changes: Values, sensors: Mapping[str, Values]) -> mujoco.MjSpec:
    """Returns a model with changes and sensors; it is known to compile.

    Args:
        path: its MJCF or URDF.
        changes: the changes, see above.
        sensors: sensors to add, by name.

    Raises:
        InvalidEntryError: the model does not compile, or a change does not suit it.
    """
    spec = read_model(path)
    name_all(spec)
    positions = sum(_POSITIONS.get(joint.type, 1) for joint in spec.joints)
    short = {key.name: len(key.qpos) for key in spec.keys if 0 < len(key.qpos) < positions}
    _drop(spec, changes.get("drop", ()))
    if changes.get("floor"):
        if spec.geom("floor") is not None:
            raise InvalidEntryError(
                ("changes", "floor"), "the model has a geom of this name already; leave floor out."
            )
        plane = mujoco.mjtGeom.mjGEOM_PLANE  # as large as it has to be, and drawn in grey
        spec.worldbody.add_geom(name="floor", type=plane, size=[0, 0, 1], rgba=[0.8, 0.8, 0.8, 1])
    for i, pattern in enumerate(changes.get("remove_actuators", ())):
        for actuator in _matching(spec.actuators, "actuator", pattern, "remove_actuators", i):
            spec.delete(actuator)
    _remove_bodies(spec, changes.get("remove_bodies", ()))
    _set_option(spec.option, changes.get("option", {}))
    for kind, elements in (("joint", spec.joints), ("geom", spec.geoms)):
        for pattern, values in changes.get(f"{kind}s", {}).items():
            if "lock" in values:
                continue
            for element in _matching(elements, kind, pattern, f"{kind}s", pattern):
                _change(spec, element, values, ("changes", f"{kind}s", pattern))
    for pattern, values in changes.get("bodies", {}).items():
        for body in _matching(spec.bodies[1:], "body", pattern, "bodies", pattern):
            _weigh(spec, body, values["mass"], ("changes", "bodies", pattern))
    if "only_contacts" in changes:
        _restrict_contacts(spec, changes["only_contacts"])
    for name, motor in changes.get("actuators", {}).items():
        _add_motors(spec, name, motor)
    locked = dict[str, float]()
    for pattern, values in changes.get("joints", {}).items():
        if "lock" in values:
            single = [joint for joint in spec.joints if joint.type in _SCALAR_JOINTS]
            found = _matching(single, "hinge or slide", pattern, "joints", pattern)
            locked |= {joint.name: values["lock"] for joint in found}
    freed = _to_free(spec, changes.get("free_bodies", ()))
    if "remove_actuators" in changes or "actuators" in changes:
        _drop_references(spec, changes)
    if locked or freed:
        _remove_joints(spec, locked, freed)
    for name, sensor in sensors.items():
        _add_sensor(spec, name, sensor)
    model = _compile(spec)
    for name, sensor in sensors.items():
        _check_directions(model, name, sensor)
    for name, size in short.items():  # which MuJoCo has filled
        raise InvalidEntryError(
            ("model",),
            f"the keyframe {quote(name)} has {size} positions (qpos), but the model has "
            f"{positions}; give it all of them.",
        )
    return spec


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


def _drop(spec: mujoco.MjSpec, what: Sequence[str]) -> None:
    """Removes what only shows: always skins and the pictures in files, which no text could hold."""
    for skin in list(spec.skins):
        spec.delete(skin)
    pictures = {
        texture.name
        for texture in spec.textures
        if "textures" in what or texture.file or any(texture.cubefiles)
    }
    for material in spec.materials:
        material.textures = ["" if name in pictures else name for name in material.textures]
    for texture in list(spec.textures):
        if texture.name in pictures:
            spec.delete(texture)
    touched = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    for geom in list(spec.geoms):
        weighs = not (geom.parent.explicitinertial or geom.mass == 0.0 or geom.density == 0.0)
        touches = geom.contype or geom.conaffinity or geom.name in touched
        is_shown = not (touches or (weighs and geom.parent.name != "world"))
        is_mesh = geom.type == mujoco.mjtGeom.mjGEOM_MESH
        if (is_mesh and "meshes" in what) or (is_shown and "visual" in what):
            spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if "meshes" in what or ("visual" in what and mesh.name not in used):
            spec.delete(mesh)


def _remove_bodies(spec: mujoco.MjSpec, patterns: Sequence[str]) -> None:
    """Removes bodies with all that they carry; what was turned to one of them no longer turns."""
    for i, pattern in enumerate(patterns):
        for body in _matching(spec.bodies[1:], "body", pattern, "remove_bodies", i):
            if spec.body(body.name) is not None:  # not with one that carries it
                spec.delete(body)
    for turned in (*spec.cameras, *spec.lights):
        if turned.targetbody and spec.body(turned.targetbody) is None:
            turned.targetbody, turned.mode = "", mujoco.mjtCamLight.mjCAMLIGHT_FIXED


def _to_free(spec: mujoco.MjSpec, patterns: Sequence[str]) -> list[Any]:
    """Returns the bodies that shall get a free joint, which MuJoCo has in the world alone."""
    found = dict[str, Any]()  # once each, though several patterns may match it
    for i, pattern in enumerate(patterns):
        bodies = _matching(spec.bodies[1:], "body", pattern, "free_bodies", i)
        found |= {body.name: body for body in bodies}
    for body in found.values():
        if body.parent.name != "world":
            raise InvalidEntryError(
                ("changes", "free_bodies"),
                f"{quote(body.name)} is carried by {quote(body.parent.name)}, and MuJoCo has "
                "free joints of bodies in the world alone; name one of those.",
            )
    return [*found.values()]


def _remove_joints(spec: mujoco.MjSpec, locked: Mapping[str, float], freed: Sequence[Any]) -> None:
    """Removes joints with all that is of them; a locked one leaves its body turned or shifted.

    Bodies that are freed get a free joint in place of theirs, and in keyframes are where they were,
    at rest.

    A body's joints act one after another, X = B J₁ J₂. If J₂ is locked, its motion goes into B, and
    J₁ is named in the frame behind it: X = (B J₂) (J₂⁻¹ J₁ J₂).
    """
    before = _compile(spec)
    names = {*locked, *(joint.name for body in freed for joint in body.joints)}
    joint_type, kinds = mujoco.mjtObj.mjOBJ_JOINT, (0, 1)  # of a joint's transmission
    tied = {
        int(np.flatnonzero(before.tendon_adr <= place)[-1])
        for place in range(before.nwrap)
        if before.wrap_type[place] == mujoco.mjtWrap.mjWRAP_JOINT
        and before.joint(before.wrap_objid[place]).name in names
    }
    tendons = {tendon.name: tendon for i, tendon in enumerate(spec.tendons) if i in tied}
    for actuator in list(spec.actuators):
        of_tendon = actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON
        if actuator.target in (
            tendons if of_tendon else names if actuator.trntype in kinds else ()
        ):
            spec.delete(actuator)
    left = {actuator.name for actuator in spec.actuators}
    for sensor in list(spec.sensors):
        of = {
            joint_type: sensor.objname in names,
            mujoco.mjtObj.mjOBJ_TENDON: sensor.objname in tendons,
            mujoco.mjtObj.mjOBJ_ACTUATOR: sensor.objname not in left,
        }
        if of.get(sensor.objtype):
            spec.delete(sensor)
    for equality in list(spec.equalities):
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and names & {equality.name1, equality.name2}:
            spec.delete(equality)
    for tendon in tendons.values():
        spec.delete(tendon)
    for body in spec.bodies:
        kept: list[Any] = []
        if any(joint.name in locked for joint in body.joints):
            body.set_frame(body.parent.add_frame())  # an even one, since its place counts all
            body.pos, body.quat = before.body(body.name).pos, before.body(body.name).quat
            body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        for joint in list(body.joints):
            if joint.name in locked:
                _lock(before, body, joint, locked[joint.name], kept)
            if joint.name not in names:
                kept.append(joint)
    for joint in [each for each in spec.joints if each.name in names]:
        spec.delete(joint)
    for body in freed:
        body.add_freejoint()
    name_all(spec)
    for key in spec.keys:
        key.qpos, key.qvel, key.ctrl, key.act = [], [], [], []
    after, data = _compile(spec), mujoco.MjData(before)
    bodies = {body.joints[0].name: before.body(body.name).id for body in freed}
    for k, key in enumerate(spec.keys):
        positions, velocities = after.qpos0.copy(), np.zeros(after.nv)
        data.qpos[:] = before.key_qpos[k]
        mujoco.mj_kinematics(before, data)
        for i in range(after.njnt):
            if body := bodies.get(after.joint(i).name):
                pose = np.concatenate([data.xpos[body], data.xquat[body]])
                positions[after.jnt_qposadr[i] :][:7] = pose
                continue
            old = before.joint(after.joint(i).name)
            positions[after.jnt_qposadr[i] :][: len(old.qpos0)] = before.key_qpos[k][
                old.qposadr[0] :
            ][: len(old.qpos0)]
            size = len(before.dof_jntid[before.dof_jntid == old.id])
            velocities[after.jnt_dofadr[i] :][:size] = before.key_qvel[k][old.dofadr[0] :][:size]
        key.qpos, key.qvel = positions, velocities


def _compile(spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        with warnings.catch_warnings():  # of old words in somebody's file, which nobody here edits
            warnings.simplefilter("ignore")
            return spec.compile()
    except MUJOCO_ERRORS as error:
        sentence = f"the model, as it is changed, does not compile: {error_text(error)}"
        if "opening file" in sentence or "resource" in sentence:
            sentence += "; `changes: {drop: [visual]}` or `{drop: [meshes]}` leaves meshes out"
        raise InvalidEntryError(("model",), f"{sentence}.") from error


def _lock(model: mujoco.MjModel, body: Any, joint: Any, at: float, kept: Sequence[Any]) -> None:
    """Moves a body as its joint would to a position [m, rad], and its joints before that one."""
    i = model.joint(joint.name).id
    axis, pivot = model.jnt_axis[i], model.jnt_pos[i]
    way = at - float(model.qpos0[model.jnt_qposadr[i]])
    turn, matrix = np.array([1.0, 0, 0, 0]), np.eye(3).ravel()
    shift = way * axis
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        mujoco.mju_axisAngle2Quat(turn, axis, way)
        mujoco.mju_quat2Mat(matrix, turn)
        shift = pivot - matrix.reshape(3, 3) @ pivot
    inner = matrix.reshape(3, 3)
    outer, quat = np.empty(9), np.array(body.quat)
    mujoco.mju_quat2Mat(outer, quat)
    body.pos = np.array(body.pos) + outer.reshape(3, 3) @ shift
    after = np.empty(4)
    mujoco.mju_mulQuat(after, quat, turn)
    body.quat = after
    for other in kept:
        other.axis = inner.T @ np.array(other.axis)
        other.pos = inner.T @ (np.array(other.pos) - shift)


def _weigh(spec: mujoco.MjSpec, body: Any, mass: float, place: Place) -> None:
    """Sets the mass of a body [kg]; its inertia grows alike."""
    own = float(_compile(spec).body(body.name).mass[0])
    if not own:
        raise InvalidEntryError(
            place,
            f"{quote(body.name)} weighs nothing, so that no share of "
            "its inertia could grow; give it an inertial in the model.",
        )
    share = mass / own
    if body.explicitinertial:
        body.mass *= share
        body.inertia = share * np.array(body.inertia)
        body.fullinertia = share * np.array(body.fullinertia)
    for geom in body.geoms:
        geom.density *= share
        geom.mass *= share  # nan, where density decides


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
    with at_entry("changes", *place):
        return [by_name[name] for name in matching_names(what, pattern, list(by_name))]


def _set_option(option: Any, values: Values) -> None:
    for name, value in values.items():
        if name in _WORDS:
            words, prefix = _WORDS[name]
            setattr(option, name, int(getattr(words, prefix + value.upper())))
        else:
            setattr(option, name, value)


def _change(spec: mujoco.MjSpec, element: Any, values: Values, place: Place) -> None:
    """Sets fields of a joint or geom; a list shorter than the field leaves the rest as it is."""
    for name, value in values.items():
        field = getattr(element, name)
        in_degrees = spec.compiler.degree and element.type == mujoco.mjtJoint.mjJNT_HINGE
        field_value = np.degrees(value) if name == "range" and in_degrees else value
        if name in _LIMITED:
            setattr(element, _LIMITED[name], 1)
        if not isinstance(field, np.ndarray):
            setattr(element, name, field_value)
        elif np.size(value) <= len(field):
            field[: np.size(value)] = field_value
        else:
            raise InvalidEntryError(
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
    """Adds a motor or a servo to a joint, or to each hinge and slide that a pattern matches."""
    limit, place = motor.get("limit"), ("changes", "actuators", key)
    patterns = [motor["joint"]] if isinstance(motor["joint"], str) else motor["joint"]
    stiffness = motor.get("stiffness")
    if stiffness is None and "damping" in motor:
        raise InvalidEntryError(
            (*place, "damping"), "a motor has none; name the stiffness of a servo, too."
        )
    joints = [
        joint
        for pattern in patterns
        for joint in _matching(spec.joints, "joint", pattern, *place[1:], "joint")
        if joint.type in _SCALAR_JOINTS
    ]
    if not joints:
        raise InvalidEntryError(
            (*place, "joint"),
            f"{quote(patterns[0])} is neither a hinge nor a slide, but a motor drives only those.",
        )
    for joint in joints:
        name = key if [joint.name] == patterns else joint.name
        if name in {actuator.name for actuator in spec.actuators}:
            raise InvalidEntryError(
                place,
                f"the model has an actuator {quote(name)}; remove it by remove_actuators first.",
            )
        actuator = spec.add_actuator(name=name, target=joint.name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        # The model's defaults of actuators must not limit it.
        actuator.ctrllimited = actuator.forcelimited = 0
        actuator.ctrlrange = actuator.forcerange = [0, 0]
        ends = [-limit, limit] if limit is not None else None
        if stiffness is None:
            actuator.set_to_motor()
            if ends:
                actuator.ctrllimited, actuator.ctrlrange = 1, ends
        else:
            has_range = joint.range[0] < joint.range[1]
            damping = motor.get("damping", 0.0)
            actuator.set_to_position(kp=stiffness, kv=damping, inheritrange=has_range)
            actuator.ctrllimited = int(has_range)
            if ends:
                actuator.forcelimited, actuator.forcerange = 1, ends
        actuator.gear = [1.0, 0, 0, 0, 0, 0]  # nor the defaults' gear count
        actuator.armature = motor.get("armature", 0.0)


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


def _add_sensor(spec: mujoco.MjSpec, name: str, sensor: Values) -> None:
    """Adds a sensor of one object, which may be relative to another one."""
    place = ("sensors", name)
    if name in {other.name for other in spec.sensors}:
        raise InvalidEntryError(
            place, "the model has a sensor of this name; use that one, or choose another name."
        )
    kind = SENSOR_TYPES[sensor["type"]]
    added = spec.add_sensor(name=name)
    added.type = getattr(mujoco.mjtSensor, f"mjSENS_{(kind.mujoco_name or sensor['type']).upper()}")
    if kind.objects:
        added.objtype, added.objname = _object(spec, sensor, place)
    if "xbody" in sensor and "site" in kind.objects and "body" not in kind.objects:
        # MuJoCo measures these at sites alone, so the frame gets one, which no picture shows.
        site = spec.body(added.objname).add_site(name=f"{name}_frame", group=5)
        added.objtype, added.objname = mujoco.mjtObj.mjOBJ_SITE, site.name
    if "relative_to" in sensor:
        added.reftype, added.refname = _object(spec, sensor["relative_to"], (*place, "relative_to"))
    if "cutoff" in sensor:
        added.cutoff = sensor["cutoff"]


def _check_directions(model: mujoco.MjModel, name: str, sensor: Values) -> None:
    """Refuses directions of a body's principal axes, which are hardly ever meant.

    MuJoCo's `body` stands for the body's inertial frame, whose axes are sorted by inertia.
    """
    frames = {"relative_to": sensor.get("relative_to", {})}
    if sensor["type"] in DIRECTIONS:
        frames["body"] = sensor
    for key, frame in frames.items():
        body = frame.get("body")
        if body and abs(model.body(body).iquat[0]) < 1 - 1e-9:
            raise InvalidEntryError(
                ("sensors", name, key),
                f"`body: {body}` means its principal axes of inertia, which are turned from its "
                f"own frame; write `xbody: {body}` for the directions of that frame.",
            )


def _object(spec: mujoco.MjSpec, record: Values, place: Place) -> tuple[mujoco.mjtObj, str]:
    """Returns kind and name of the object that a record names."""
    kind = next(kind for kind in OBJECTS if kind in record)
    several = {"body": "bodies", "xbody": "bodies"}.get(kind, f"{kind}s")
    names = [element.name for element in getattr(spec, several) if element.name]
    with at_entry(*place, kind):
        return getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), find_name(kind, record[kind], names)


def self_contained(spec: mujoco.MjSpec) -> str:
    """Returns the MJCF of a model whose meshes stand in the text, and whose textures are left out.

    The model is changed by this.

    Raises:
        InvalidInputError: the model needs a file of another kind.
    """
    model = _compile(spec)
    if in_files := [hfield.name for hfield in spec.hfields if hfield.file]:
        raise InvalidInputError(
            f"The height field '{in_files[0]}' is in a file, which is not supported: write its "
            "heights into the model, as the attribute elevation."
        )
    for mesh in spec.meshes:
        if mesh.file:
            _write_in(model, mesh)
    spec.meshdir = spec.texturedir = ""
    _compile(spec)
    with warnings.catch_warnings():  # the same as when it was first compiled
        warnings.simplefilter("ignore")
        return str(spec.to_xml())


def _write_in(model: mujoco.MjModel, mesh: mujoco.MjsMesh) -> None:
    """Gives a mesh its vertices and faces, where its file had put them."""
    i = model.mesh(mesh.name).id
    first, count = model.mesh_vertadr[i], model.mesh_vertnum[i]
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[i])
    # The compiler has moved the mesh into the frame of its inertia.
    vertices = model.mesh_vert[first : first + count] @ rotation.reshape(3, 3).T + model.mesh_pos[i]
    first, count = model.mesh_faceadr[i], model.mesh_facenum[i]
    mesh.uservert = vertices.ravel().tolist()
    mesh.userface = model.mesh_face[first : first + count].ravel().tolist()
    mesh.file, mesh.content_type = "", ""
    mesh.scale, mesh.refpos, mesh.refquat = [1, 1, 1], [0, 0, 0], [1, 0, 0, 0]
