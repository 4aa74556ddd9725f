# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What each actuator of a model is, as `robot.controls` has it."""

from itertools import compress
from typing import NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.robot.controls import CONTROL_BOUND, ControlKind, Controls
from vgps_ros.simulation.model import actuated_joint_names, control_range

_GAIN, _BIAS, _DYNAMICS = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn
_TRANSMISSION, _JOINT = mujoco.mjtTrn, mujoco.mjtJoint
_LAGGING = (_DYNAMICS.mjDYN_NONE, _DYNAMICS.mjDYN_FILTER, _DYNAMICS.mjDYN_FILTEREXACT)
_OF_JOINTS = (_TRANSMISSION.mjTRN_JOINT, _TRANSMISSION.mjTRN_JOINTINPARENT)
_SINGLE = (_JOINT.mjJNT_SLIDE, _JOINT.mjJNT_HINGE)
# Gains, biases and dynamics of what exerts no force at u = 0, after a while.
_RELAXING = (
    (_GAIN.mjGAIN_FIXED, _GAIN.mjGAIN_AFFINE, _GAIN.mjGAIN_MUSCLE),
    (_BIAS.mjBIAS_NONE, _BIAS.mjBIAS_MUSCLE),
    (*_LAGGING, _DYNAMICS.mjDYN_MUSCLE),
)


def controls_of(model: mujoco.MjModel) -> Controls:
    """Returns the controls of a model."""
    names = tuple(actuated_joint_names(model))
    found = [_actuator(model, i) for i in range(model.nu)]
    s, b, k_p, k_d, scale, offset, most = np.array([each.numbers for each in found]).T.copy()
    return Controls(
        names,
        tuple(each.kind for each in found),
        tuple(each.unit for each in found),
        control_range(model),
        *(s, b, k_p, k_d, scale, offset, most),
        positions=np.array([each.position for each in found]),
        velocities=np.array([each.velocity for each in found]),
        restless=tuple(compress(names, (each.is_restless for each in found))),
    )


def resting_controls(data: mujoco.MjData) -> Array:
    """Returns u by which servos of positions rest where they are, and 0 of others, shape (n_u,)."""
    model = data.model
    are_servos = controls_of(model).are(ControlKind.POSITION)
    gain = np.where(are_servos, model.actuator_gainprm[:, 0], 1.0)
    offset, slope = (-model.actuator_biasprm[:, :2] / gain[:, None]).T
    return np.where(are_servos, slope * data.actuator_length + offset, 0.0)


class _Actuator(NamedTuple):
    kind: ControlKind
    unit: str
    numbers: tuple[float, ...]  # s, b, k_p, k_d, ∂w/∂u, w at u = 0, and the largest |τ| of a servo
    position: Array
    velocity: Array
    is_restless: bool


def _actuator(model: mujoco.MjModel, i: int) -> _Actuator:
    turns, gear, position, velocity = _coordinate(model, i)
    gain, bias = _GAIN(model.actuator_gaintype[i]), _BIAS(model.actuator_biastype[i])
    dynamics = _DYNAMICS(model.actuator_dyntype[i])
    s, is_affine = gear * float(model.actuator_gainprm[i, 0]), bias == _BIAS.mjBIAS_AFFINE
    turned = model.actuator_biasprm[i, :3] * is_affine * gear * np.array([1.0, -gear, -gear])
    b, k_p, k_d = (turned + 0.0).tolist()
    is_linear = gain == _GAIN.mjGAIN_FIXED and bool(s) and min(k_p, k_d) >= 0.0
    is_linear &= is_affine or bias == _BIAS.mjBIAS_NONE
    kind, numbers = ControlKind.ACTIVATION, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    if is_linear and dynamics in _LAGGING:
        motor = ControlKind.TORQUE if turns else ControlKind.FORCE
        kind = ControlKind.POSITION if k_p else ControlKind.VELOCITY if k_d else motor
        size = k_p or k_d or 1.0
        numbers = (s, b, k_p, k_d, s / size, b / size)
    elif is_linear and k_p and dynamics == _DYNAMICS.mjDYN_INTEGRATOR:
        kind, numbers = ControlKind.VELOCITY, (s / k_p, 0.0, 0.0, 0.0, s / k_p, 0.0)
    rests = kind is not ControlKind.POSITION or bool(position.any())
    if kind is ControlKind.ACTIVATION:
        found = zip((gain, bias, dynamics), _RELAXING, strict=True)
        rests = all(each in known for each, known in found)
    unit = kind.units[0 if turns else -1]
    largest = CONTROL_BOUND
    if model.actuator_forcelimited[i]:
        largest = float(abs(gear) * np.abs(model.actuator_forcerange[i]).max())
    return _Actuator(kind, unit, (*numbers, largest), position, velocity, not rests)


def _coordinate(model: mujoco.MjModel, i: int) -> tuple[bool, float, Array, Array]:
    """Returns whether an actuator's coordinate y is an angle, its gear, and its rows of P and V.

    The rows are zero where y does not depend on the state linearly, as of a free body or a site.
    """
    position, velocity = (np.zeros(model.nq + model.nv + model.na) for _ in range(2))
    kind, target = _TRANSMISSION(model.actuator_trntype[i]), int(model.actuator_trnid[i, 0])
    types, gears = [_JOINT(each) for each in model.jnt_type], model.actuator_gear[i]
    joints: list[tuple[int, float]] = []
    if kind in _OF_JOINTS and types[target] in _SINGLE:
        joints = [(target, 1.0)]
    elif kind == _TRANSMISSION.mjTRN_TENDON:
        wraps = slice(model.tendon_adr[target], model.tendon_adr[target] + model.tendon_num[target])
        if (model.wrap_type[wraps] == int(mujoco.mjtWrap.mjWRAP_JOINT)).all():
            joints = [*zip(model.wrap_objid[wraps], model.wrap_prm[wraps], strict=True)]
    elif kind in (*_OF_JOINTS, _TRANSMISSION.mjTRN_SITE):
        pushes = float(np.linalg.norm(gears[:3]))
        is_ball = kind in _OF_JOINTS and types[target] == _JOINT.mjJNT_BALL
        gear = pushes or float(np.linalg.norm(gears[3:]))
        return is_ball or not pushes, gear, position, velocity
    for joint, share in joints:
        position[model.jnt_qposadr[joint]] += share
        velocity[model.nq + model.jnt_dofadr[joint]] += share
    turns = bool(joints) and all(types[joint] == _JOINT.mjJNT_HINGE for joint, _ in joints)
    return turns, float(gears[0]), position, velocity


def closed_loops(mjcf: str, stiffness: Array, damping: Array) -> str:
    """Returns a robot whose actuators close loops of positions, at the rate of the simulator.

    The control of each is the position that its joint should have. A motor keeps its limits of
    torque. An actuator whose loop has these gains already, or that shall have none, stays.

    Args:
        mjcf: the robot; it is returned as it is where nothing changes.
        stiffness: k_p at each joint, shape (n_u,) [N·m/rad, N/m].
        damping: k_d at each joint, shape (n_u,) [N·m·s/rad, N·s/m].

    Raises:
        InvalidInputError: a gain does not suit its actuator.
    """
    spec = mujoco.MjSpec.from_string(mjcf)
    model = spec.compile()
    controls, exact = controls_of(model), dict[int, dict[str, list[float]]]()
    closed = controls.with_servos(stiffness, damping)
    for i, actuator in enumerate(spec.actuators):
        k_p, k_d = float(closed.stiffness[i]), float(closed.damping[i])
        if (k_p, k_d) == (controls.stiffness[i], controls.damping[i]):
            continue
        low, high = (limit[i] for limit in controls.limits)
        _, gear, *_ = _coordinate(model, i)
        if controls.kinds[i] is ControlKind.POSITION:
            low, high = (limit[i] for limit in closed.limits)
            actuator.ctrllimited = int(np.isfinite(low))
            actuator.ctrlrange = [low, high] if np.isfinite(low) else [0.0, 0.0]
        else:
            ends = np.sort(controls.strength[i] / gear * np.array([low, high]))
            actuator.ctrllimited, actuator.ctrlrange = 0, [0.0, 0.0]
            actuator.forcelimited = int(np.isfinite(ends).all())
            actuator.forcerange = ends if np.isfinite(ends).all() else [0.0, 0.0]
        actuator.gaintype, actuator.biastype = _GAIN.mjGAIN_FIXED, _BIAS.mjBIAS_AFFINE
        gains = {
            "gainprm": [k_p / gear, 0.0, 0.0],
            "biasprm": [0.0, -k_p / gear**2, -k_d / gear**2],
        }
        actuator.gainprm[:3], actuator.biasprm[:3] = gains.values()
        exact[i] = gains
    if not exact:
        return mjcf
    for key in spec.keys:
        key.ctrl = []  # of the former actuators
    try:
        spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise InvalidInputError(
            f"The robot does not compile with the gains {stiffness} and {damping}: {error}."
        ) from error
    robot = ElementTree.fromstring(spec.to_xml())  # which has six digits
    for i, element in enumerate(robot.iterfind("actuator/*")):  # some may have no name
        for name, numbers in exact.get(i, {}).items():
            element.set(name, " ".join(map(repr, numbers)))
    return ElementTree.tostring(robot, encoding="unicode")
