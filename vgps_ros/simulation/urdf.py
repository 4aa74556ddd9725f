# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a MuJoCo model as URDF, which robot_state_publisher, RViz, Foxglove and MoveIt read.

Links and joints are those of `frames`, so that a joint's position in URDF is its position in
MuJoCo. Free joints and balls are `floating`: their poses come by tf, since no number of
`joint_states` tells them. What URDF has no shape for is drawn as others: a capsule as a cylinder
with two spheres, an ellipsoid or a mesh as its box; planes are left out.

Its `<ros2_control>` says what each joint takes and tells. The plugin that it names is one of
ros2_control's that speaks by the topics `joint_command` and `joint_states`.
"""

from collections.abc import Iterator
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.robot.bodies import rotate
from vgps_ros.robot.controls import CONTROL_BOUND, ControlKind
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.frames import FIXED, ROOT, Link, links
from vgps_ros.simulation.model import joint_names

_UNLIMITED = 1e6  # URDF demands limits also where the model has none [m, N, N·m, m/s, rad/s]
_HIDDEN_GROUP = 3  # the first group of geometries that MuJoCo's own viewer does not show
_PLUGIN = "joint_state_topic_hardware_interface/JointStateTopicSystem"
_TOPICS = {"joint_commands_topic": "joint_command", "joint_states_topic": "joint_states"}
_GEOM, _JOINT = mujoco.mjtGeom, mujoco.mjtJoint
_KINDS = {
    _JOINT.mjJNT_FREE: "floating",
    _JOINT.mjJNT_BALL: "floating",
    _JOINT.mjJNT_SLIDE: "prismatic",
    _JOINT.mjJNT_HINGE: "revolute",
}

Shape = tuple[str, dict[str, str], Array]
"""A URDF geometry's tag and attributes, and its centre in the frame of MuJoCo's geometry [m]."""


def urdf(model: mujoco.MjModel) -> str:
    """Returns the robot as URDF."""
    robot = Element("robot", name=model.names.partition(b"\0")[0].decode())
    _add_link(robot, model, ROOT, 0)
    for link in links(model):
        _add_link(robot, model, link.name, link.body)
        _add_joint(robot, model, link)
    _add_ros2_control(robot, model)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True)


def _add_link(robot: Element, model: mujoco.MjModel, name: str, body: int | None) -> None:
    link = SubElement(robot, "link", name=name)
    if body is None:
        return
    if body and model.body_mass[body] > 0:
        inertial = SubElement(link, "inertial")
        _add_origin(inertial, model.body_ipos[body], model.body_iquat[body])
        SubElement(inertial, "mass", value=_text(model.body_mass[body]))
        moments = zip(("ixx", "iyy", "izz"), map(_text, model.body_inertia[body]), strict=True)
        SubElement(inertial, "inertia", dict(moments), ixy="0", ixz="0", iyz="0")
    for i in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        material = model.geom_matid[i]
        rgba = model.geom_rgba[i] if material < 0 else model.mat_rgba[material]
        if rgba[3] > 0 and model.geom_group[i] < _HIDDEN_GROUP:
            for visual in _add_shapes(link, "visual", model, i):
                colour = _text(*rgba.astype(float).round(4))
                painted = SubElement(visual, "material", name=f"rgba {colour}")
                SubElement(painted, "color", rgba=colour)
        if model.geom_contype[i] or model.geom_conaffinity[i]:
            list(_add_shapes(link, "collision", model, i))


def _add_joint(robot: Element, model: mujoco.MjModel, link: Link) -> None:
    i = link.joint
    if i == FIXED:
        joint = SubElement(robot, "joint", name=f"{link.name}_fixed", type="fixed")
    else:
        kind = _KINDS[_JOINT(model.jnt_type[i])]
        if kind == "revolute" and not model.jnt_limited[i]:
            kind = "continuous"
        joint = SubElement(robot, "joint", name=model.joint(i).name or f"joint_{i}", type=kind)
    _add_origin(joint, link.position, link.rotation)
    SubElement(joint, "parent", link=link.parent)
    SubElement(joint, "child", link=link.name)
    if i == FIXED or kind == "floating":
        return
    SubElement(joint, "axis", xyz=_text(*model.jnt_axis[i]))
    low, high = model.jnt_range[i] if model.jnt_limited[i] else (-_UNLIMITED, _UNLIMITED)
    force = abs(model.jnt_actfrcrange[i]).max() if model.jnt_actfrclimited[i] else _UNLIMITED
    limit = {"effort": _text(force), "velocity": _text(_UNLIMITED)}
    if kind != "continuous":
        limit |= {"lower": _text(low), "upper": _text(high)}
    SubElement(joint, "limit", limit)
    dof = model.jnt_dofadr[i]
    damping, friction = (_text(v[dof]) for v in (model.dof_damping, model.dof_frictionloss))
    SubElement(joint, "dynamics", damping=damping, friction=friction)


def _add_ros2_control(robot: Element, model: mujoco.MjModel) -> None:
    """Adds the interfaces of the joints; activations, as of muscles, are none of ros2_control."""
    system = SubElement(robot, "ros2_control", name=f"{robot.get('name')}_system", type="system")
    hardware = SubElement(system, "hardware")
    SubElement(hardware, "plugin").text = _PLUGIN
    for name, topic in _TOPICS.items():
        SubElement(hardware, "param", name=name).text = topic
    commands: dict[str, list[tuple[str, Array]]] = {}
    controls = controls_of(model) if model.nu else None
    if controls:
        ends = np.sort([controls.at_joints(limit) for limit in controls.limits], axis=0).T
        for name, kind, limits in zip(controls.names, controls.kinds, ends, strict=True):
            if kind is not ControlKind.ACTIVATION:
                commands.setdefault(name, []).append((kind.field, limits))
    for name in joint_names(model):
        joint = SubElement(system, "joint", name=name)
        for field, limits in commands.get(name, []):
            interface = SubElement(joint, "command_interface", name=field)
            for end, limit in zip(("min", "max"), limits.tolist(), strict=True):
                if abs(limit) < CONTROL_BOUND:
                    SubElement(interface, "param", name=end).text = _text(limit)
        for field in ("position", "velocity", "effort"):
            SubElement(joint, "state_interface", name=field)


def _add_shapes(link: Element, role: str, model: mujoco.MjModel, geom: int) -> Iterator[Element]:
    position, rotation = model.geom_pos[geom], model.geom_quat[geom]
    for tag, size, centre in _shapes(model, geom):
        added = SubElement(link, role)
        _add_origin(added, position + rotate(centre, rotation), rotation)
        SubElement(SubElement(added, "geometry"), tag, size)
        yield added


def _shapes(model: mujoco.MjModel, geom: int) -> list[Shape]:
    """Returns the shapes of URDF that draw a geometry of MuJoCo."""
    radius, half, _ = model.geom_size[geom].tolist()
    middle, end = np.zeros(3), np.array([0.0, 0.0, half])
    sphere = {"radius": _text(radius)}
    cylinder = sphere | {"length": _text(2 * half)}
    match _GEOM(model.geom_type[geom]):
        case _GEOM.mjGEOM_PLANE:
            return []
        case _GEOM.mjGEOM_SPHERE:
            return [("sphere", sphere, middle)]
        case _GEOM.mjGEOM_CYLINDER:
            return [("cylinder", cylinder, middle)]
        case _GEOM.mjGEOM_CAPSULE:
            ends = [("sphere", sphere, end), ("sphere", sphere, -end)]
            return [("cylinder", cylinder, middle), *ends]
    box = model.geom_aabb[geom]  # of a mesh too: it needs no file, as nothing on this topic may
    return [("box", {"size": _text(*(2 * box[3:]))}, box[:3])]


def _add_origin(owner: Element, position: Array, rotation: Array) -> None:
    SubElement(owner, "origin", xyz=_text(*position), rpy=_text(*_roll_pitch_yaw(rotation)))


def _roll_pitch_yaw(quaternion: Array) -> tuple[float, float, float]:
    """Returns the angles about the fixed axes x, y and z [rad], also exact near a pitch of 90°.

    Yaw comes first, and roll from what remains of the rotation without it.
    """
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion / np.linalg.norm(quaternion))
    r = matrix.reshape(3, 3)
    yaw = np.arctan2(r[1, 0], r[0, 0])
    sin, cos = np.sin(yaw), np.cos(yaw)
    pitch = np.arctan2(-r[2, 0], cos * r[0, 0] + sin * r[1, 0])
    roll = np.arctan2(sin * r[0, 2] - cos * r[1, 2], cos * r[1, 1] - sin * r[0, 1])
    return roll, pitch, yaw


def _text(*numbers: float) -> str:
    """Returns numbers in digits that give the same numbers again."""
    return " ".join(repr(float(number)) for number in numbers)
