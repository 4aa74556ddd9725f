# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compiles a robot's MJCF, and names what its states, controls and sensors hold.

A sensor's values are named after it: `touch` if there is one, `velocity/x` to `velocity/z` if there
are three, `attitude/w` to `attitude/z` for a quaternion, and `fromto/0`, `fromto/1`, ... otherwise.
"""

import multiprocessing
import resource
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import lru_cache
from itertools import product
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.checks import error_text, nearest, quote
from vgps_ros.core.cores import count_cores
from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array

_JOINT = mujoco.mjtJoint
# Coordinates of a joint in qpos, in qvel, and of a change of its position, by its type.
_ANGLES, _RATES, _ROTATION = ("qw", "qx", "qy", "qz"), ("wx", "wy", "wz"), ("rx", "ry", "rz")
_COORDINATES: dict[mujoco.mjtJoint, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]] = {
    _JOINT.mjJNT_FREE: (
        ("x", "y", "z", *_ANGLES),
        ("vx", "vy", "vz", *_RATES),
        ("x", "y", "z", *_ROTATION),
    ),
    _JOINT.mjJNT_BALL: (_ANGLES, _RATES, _ROTATION),
    _JOINT.mjJNT_SLIDE: (("position",), ("velocity",), ("position",)),
    _JOINT.mjJNT_HINGE: (("position",), ("velocity",), ("position",)),
}
_SECONDS, _OWN_SECONDS = 10, 60  # of a processor: for a text of others, for the user's files
_BYTES = 2 << 30  # that a child process may take to compile a model, beyond what it inherits
MUJOCO_ERRORS = (ValueError, RuntimeError, MemoryError, mujoco.FatalError)
_AXES = {1: ("",), 3: ("/x", "/y", "/z"), 4: ("/w", "/x", "/y", "/z")}


def compile_model(mjcf: str, *, is_tried: bool = False) -> mujoco.MjModel:
    """Returns the model of an MJCF text, which needs no file.

    Args:
        mjcf: the text.
        is_tried: whether `try_model` returned it, or it was made of such a text; any other text is
            compiled by another process first.

    Raises:
        InvalidInputError: the text does not compile, refers to files or asks for too much, or
            a joint lacks its name.
    """
    if not is_tried:
        _try_text(mjcf)
    try:
        model = mujoco.MjModel.from_xml_string(mjcf)
        _ = [mujoco.MjData(model) for _ in range(count_cores())]  # as a training makes them
    except MUJOCO_ERRORS as error:
        raise InvalidInputError(
            f"The robot's MJCF, which must need no file, does not compile: {error_text(error)}."
        ) from error
    _check_awake(model)  # some of its functions end the process where bodies sleep
    if not 1e-7 <= (step := model.opt.timestep) <= 10.0:
        raise InvalidInputError(
            f"The robot's MJCF has a timestep of {step:g} s, but it must be from 1e-7 to 10 s; "
            "0.002 s is usual."
        )
    ends = ("iterations", "initpoints")
    counts = {name: getattr(model.opt, name) for name in dir(model.opt) if name.endswith(ends)}
    if (count := counts[name := max(counts, key=counts.__getitem__)]) > 10_000:
        raise InvalidInputError(
            f"The robot's MJCF has {count} {name}, but 10000 are the most; 100 are usual."
        )
    if not model.njnt:
        raise InvalidInputError(
            "The model has no joint, so nothing in it can move; each body that shall move against "
            "the one that carries it needs a <joint> or <freejoint/> in the MJCF."
        )
    if nameless := [i for i in range(model.njnt) if not model.joint(i).name]:
        raise InvalidInputError(
            f"{len(nameless)} of the model's {model.njnt} joints have no name, by which tasks and "
            'messages refer to each; write <joint name="..."/> in the MJCF.'
        )
    return model


@lru_cache(maxsize=16)
def _try_text(mjcf: str) -> None:
    try_model(lambda: [mjcf], _SECONDS)


def try_model(make: Callable[[], Iterable[str]], seconds: int | None = None) -> str:
    """Returns the first of some MJCF texts that compiles in a small process without any file.

    That process makes the texts, too, since no text tells what its model asks for.

    Args:
        make: returns the texts; it may open files.
        seconds: of the processor that the child may take [s].

    Raises:
        InvalidInputError: `make` raises one, no text compiles, or one asks for too much.
    """
    processes, seconds = multiprocessing.get_context("fork"), seconds or _OWN_SECONDS
    found, finds = processes.Pipe(duplex=False)
    child = processes.Process(target=_make_within, args=(seconds, make, finds), daemon=True)
    child.start()  # a fork takes milliseconds
    finds.close()
    answer = b""
    try:
        with suppress(EOFError):
            answer = found.recv_bytes() if found.poll(3 * seconds) else b""
    finally:
        child.kill()
        child.join()
    if not answer:
        raise InvalidInputError(
            f"The robot's MJCF does not compile: it takes more than {seconds} s or "
            f"{_BYTES >> 30} GiB, or ends its process; leave out large meshes, copies and sizes."
        )
    if answer.startswith(b"-"):
        raise InvalidInputError(answer[1:].decode())
    return answer[1:].decode()


def _make_within(seconds: int, make: Callable[[], Iterable[str]], finds: Connection) -> None:
    """Sends the first text that compiles, or the sentence of the last error, within limits."""
    limits = {resource.RLIMIT_CPU: seconds}
    if sys.platform == "linux":  # macOS limits no process's memory
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        limits[resource.RLIMIT_AS] = used + _BYTES
    for kind, limit in limits.items():
        with suppress(ValueError):  # a lower one holds already
            resource.setrlimit(kind, (limit, resource.getrlimit(kind)[1]))
    _, most = files = resource.getrlimit(resource.RLIMIT_NOFILE)
    answer = b""
    try:
        for text in make():
            resource.setrlimit(resource.RLIMIT_NOFILE, (0, most))  # it opens no file
            try:
                model = compile_model(text, is_tried=True)
                mujoco.mj_forward(model, mujoco.MjData(model))
                answer = b"+" + text.encode()
                break
            except MUJOCO_ERRORS as error:  # an InvalidInputError is one of them
                answer = b"-" + str(error).encode()
            resource.setrlimit(resource.RLIMIT_NOFILE, files)
    except InvalidInputError as error:
        answer = b"-" + str(error).encode()
    finds.send_bytes(answer)


def _check_awake(model: mujoco.MjModel) -> None:
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP:
        raise InvalidInputError(
            "The model lets resting bodies sleep, and which ones do is no part of a state; leave "
            'out `sleep="enable"` in its MJCF.'
        )


def check_supported(model: mujoco.MjModel) -> None:
    """Checks that a state of the model is (qpos, qvel, act) and no more.

    Raises:
        InvalidInputError: the model has no joint or no actuator, or remembers more, or lets bodies
            sleep, or a range's ends are swapped.
    """
    if not (model.nv and model.nu):
        raise InvalidInputError(
            f"The model has {model.nv} degrees of freedom and {model.nu} actuators, but it needs "
            "at least one of each; a task file can add motors (changes: actuators)."
        )
    if model.npluginstate or model.nhistory:
        raise InvalidInputError(
            f"The model has {model.npluginstate} states of plugins and {model.nhistory} delayed "
            "values, but no more than positions, velocities and activations can be optimised."
        )
    _check_awake(model)
    # For a range whose ends are swapped MuJoCo would set no limit.
    for owner, count, names in (
        ("actuator", model.nu, ("ctrlrange", "forcerange")),
        ("joint", model.njnt, ("range", "actfrcrange")),
    ):
        for i, name in product(range(count), names):
            low, high = getattr(model, f"{'jnt' if owner == 'joint' else owner}_{name}")[i]
            if low > high:
                raise InvalidInputError(
                    f"The {owner} {quote(getattr(model, owner)(i).name)} has {name} from "
                    f"{low:g} to {high:g}, but the first must not be above the second: exchange "
                    "them in the model."
                )


def state_space(model: mujoco.MjModel) -> StateSpace:
    """Returns the space of x = (qpos, qvel, act)."""
    free, ball = (model.jnt_qposadr[model.jnt_type == kind] for kind in (0, 1))
    quaternions = sorted([*(free + 3).tolist(), *ball.tolist()])
    return StateSpace(model.nq + model.nv + model.na, tuple(quaternions))


def state_names(model: mujoco.MjModel) -> list[str]:
    """Returns the name of each coordinate of x, such as hip/position, hip/velocity, base/qw."""
    return _names(model, 0, 1)


def deviation_names(model: mujoco.MjModel) -> list[str]:
    """Returns the name of each coordinate of a deviation; a body's rotation has rx, ry, rz."""
    return _names(model, 2, 1)


def _names(model: mujoco.MjModel, *parts: int) -> list[str]:
    of_joints = [
        f"{model.joint(i).name}/{coordinate}"
        for part in parts
        for i in range(model.njnt)
        for coordinate in _COORDINATES[_JOINT(model.jnt_type[i])][part]
    ]
    owners = np.repeat([model.actuator(i).name for i in range(model.nu)], model.actuator_actnum)
    return of_joints + [f"{name}/activation" for name in owners]


def sensor_numbers(model: mujoco.MjModel) -> dict[str, tuple[int, int]]:
    """Returns each number that the model's sensors give, by name: its sensor, and its place."""
    numbers = {}
    for i in range(model.nsensor):
        dim, first = int(model.sensor_dim[i]), int(model.sensor_adr[i])
        endings = _AXES.get(dim, tuple(f"/{j}" for j in range(dim)))
        for j, ending in enumerate(endings):
            numbers[model.sensor(i).name + ending] = (i, first + j)
    return numbers


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
        raise InvalidInputError(f"the sensor {quote(sensor)} is one number; leave its index out.")
    found = []
    for wanted in [index] if isinstance(index, str | int) else index:
        part = str(wanted)
        if isinstance(wanted, int) and 0 <= wanted < len(parts):
            part = parts[wanted]
        if part not in parts:
            raise InvalidInputError(
                f"the sensor {quote(sensor)} has the parts {', '.join(parts)}, but not "
                f"{quote(wanted)}.{nearest(part, parts)}"
            )
        found.append(f"{sensor}/{part}")
    return found


def joint_names(model: mujoco.MjModel) -> list[str]:
    """Returns the joints that turn or slide along one axis, in the order of the state."""
    single = (_JOINT.mjJNT_HINGE, _JOINT.mjJNT_SLIDE)
    return [model.joint(i).name for i in range(model.njnt) if _JOINT(model.jnt_type[i]) in single]


def joint_ranges(model: mujoco.MjModel) -> Array:
    """Returns the lowest and highest position of these joints, shape (2, J); inf: no limit."""
    single = np.isin(model.jnt_type, (_JOINT.mjJNT_HINGE, _JOINT.mjJNT_SLIDE))
    limited = model.jnt_limited[single, None].astype(bool)
    return np.where(limited, model.jnt_range[single], [-np.inf, np.inf]).T


def hinge_names(model: mujoco.MjModel) -> list[str]:
    """Returns the joints that turn, in the order of the state."""
    hinges = np.flatnonzero(model.jnt_type == _JOINT.mjJNT_HINGE)
    return [model.joint(i).name for i in hinges]


def actuated_joint_names(model: mujoco.MjModel) -> list[str]:
    """Returns the joints that the controls drive, in the order of the controls.

    Of an actuator that drives no joint, or one that another drives too, its own name is there; of
    all where a joint has such a name.
    """
    on_joints = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    joints = np.where(on_joints, model.actuator_trnid[:, 0], -1).tolist()
    own = [model.actuator(i).name for i in range(model.nu)]
    alone = [joint >= 0 and joints.count(joint) == 1 for joint in joints]
    taken = {model.joint(i).name for i in range(model.njnt)}
    if any(name in taken for name, is_alone in zip(own, alone, strict=True) if not is_alone):
        return own
    names = zip(joints, own, alone, strict=True)
    return [model.joint(joint).name if is_alone else name for joint, name, is_alone in names]


def are_motors(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Returns whether the force of each actuator is proportional to its control, shape (n_u,)."""
    return np.asarray(
        (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED)
        & (model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE)
        & (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE)
        & (model.actuator_gainprm[:, 0] * model.actuator_gear[:, 0] != 0.0)
    )


def control_range(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Returns the lowest and the highest control u of each actuator, shapes (n_u,).

    MuJoCo limits an actuator's control, its force, and the force on its joint. The last two limit
    the control of a motor too, whose force is proportional to it, and the last one only where the
    motor is alone on its joint. Where nothing does, the limit is ∓inf.
    """
    gain, gear = model.actuator_gainprm[:, 0], model.actuator_gear[:, 0]
    of_motor = are_motors(model)
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    joints = np.where(on_joint, model.actuator_trnid[:, 0], 0)
    alone = on_joint & (np.bincount(joints[on_joint], minlength=model.njnt)[joints] == 1)
    alone &= model.jnt_actgravcomp[joints] == 0
    low, high = np.full(model.nu, -np.inf), np.full(model.nu, np.inf)
    for limited, ranges, force_per_control in (
        (model.actuator_ctrllimited, model.actuator_ctrlrange, np.ones(model.nu)),
        (of_motor & (model.actuator_forcelimited > 0), model.actuator_forcerange, gain),
        (
            of_motor & alone & (model.jnt_actfrclimited[joints] > 0),
            model.jnt_actfrcrange[joints],
            gain * gear,
        ),
    ):
        ends = np.sort(ranges / np.where(limited, force_per_control, 1.0)[:, None], axis=1)
        # A range beyond the one before leaves its nearest end, at which MuJoCo clips twice.
        low, high = (
            np.where(limited, np.clip(end, low, high), before)
            for end, before in zip(ends.T, (low, high), strict=True)
        )
    return low, high


class StepStructure(NamedTuple):
    """Properties of a model's step.

    MuJoCo computes a step in stages: positions, velocities, actuation, the acceleration at which
    all forces balance, and its integration; the derivatives of a step may leave out some of them.

    Attributes:
        may_skip: whether a step may skip stages: the Runge-Kutta method leaves none valid.
        is_implicit: whether that integration is implicit in velocity.
        time_step: of a step [s].
        quaternions: the first degree of freedom of each ball and free joint's rotation.
    """

    may_skip: bool
    is_implicit: bool
    time_step: float
    quaternions: NDArray[np.int32]


def step_structure(model: mujoco.MjModel) -> StepStructure:
    """Returns the structure of a model's step."""
    integrator = model.opt.integrator
    return StepStructure(
        may_skip=bool(integrator != mujoco.mjtIntegrator.mjINT_RK4),
        is_implicit=bool(integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
        time_step=float(model.opt.timestep),
        quaternions=np.r_[
            model.jnt_dofadr[model.jnt_type == _JOINT.mjJNT_FREE] + 3,
            model.jnt_dofadr[model.jnt_type == _JOINT.mjJNT_BALL],
        ].astype(np.int32),
    )


def damping_varies(model: mujoco.MjModel) -> bool:
    """Returns whether ∂(force)/∂(velocity) changes with velocity or control, as in a fluid.

    Drag even has a kink there: its damping is proportional to |v|.
    """
    polynomials = model.dof_dampingpoly, model.tendon_dampingpoly, model.actuator_dampingpoly
    is_fixed = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
    is_affine = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_AFFINE
    is_plain = is_fixed | (is_affine & (model.actuator_gainprm[:, 2] == 0.0))
    return bool(
        model.opt.density
        or model.opt.viscosity
        or any(np.any(values) for values in polynomials)
        or not is_plain.all()
    )


_TRANSMISSION, _WRAP = mujoco.mjtTrn, mujoco.mjtWrap
_WRAPPED_GEOMS = (_WRAP.mjWRAP_SPHERE, _WRAP.mjWRAP_CYLINDER)


def cyclic_positions(model: mujoco.MjModel) -> list[int]:
    """Returns the cyclic positions, as indices in a deviation.

    They are translations of the one body that moves in the world, along a direction in which all
    that stands in the world, if anything does, is planes.
    """
    if model.ntree != 1 or model.neq or model.nmocap or model.nplugin:
        return []
    found = []
    first = int(np.flatnonzero(model.body_dofnum)[0])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    if model.body_weldid[model.body_parentid[first]] != 0 or _is_tied(model, first):
        return []
    for joint in model.body_jntadr[first] + np.arange(model.body_jntnum[first]):
        dof = int(model.jnt_dofadr[joint])
        if model.jnt_type[joint] == _JOINT.mjJNT_FREE:
            axes = np.eye(3)
        elif model.jnt_type[joint] == _JOINT.mjJNT_SLIDE:
            axes = (data.xmat[first].reshape(3, 3) @ model.jnt_axis[joint])[None]
        else:
            break  # the axes of joints behind a rotation turn with it
        if not _is_held(model, joint):
            found += [dof + i for i, axis in enumerate(axes) if _is_level(model, data, axis)]
    return found


def _is_tied(model: mujoco.MjModel, root: int) -> bool:
    """Returns whether a tendon runs over a joint of the root, or over something in the world."""
    joints, sites, *geoms = (
        model.wrap_objid[model.wrap_type == kind]
        for kind in (_WRAP.mjWRAP_JOINT, _WRAP.mjWRAP_SITE, *_WRAPPED_GEOMS)
    )
    bodies = [model.site_bodyid[sites], *(model.geom_bodyid[each] for each in geoms)]
    stands = model.body_weldid[np.concatenate(bodies)] == 0
    return bool((model.jnt_bodyid[joints] == root).any() or stands.any())


def turning_hinges(model: mujoco.MjModel) -> list[int]:
    """Returns the hinges that nothing pulls to an angle, as indices in a deviation.

    After a whole turn of one of them all is as before.
    """
    is_hinge = model.jnt_type == int(_JOINT.mjJNT_HINGE)
    return [
        int(model.jnt_dofadr[j])
        for j in range(model.njnt)
        if is_hinge[j] and not _is_held(model, j)
    ]


def _is_held(model: mujoco.MjModel, joint: int) -> bool:
    """Returns whether a spring, a limit or an actuator pulls a joint to a position."""
    if model.jnt_limited[joint] or model.jnt_stiffness[joint].any():
        return True
    for i in range(model.nu):
        kind, target = _TRANSMISSION(model.actuator_trntype[i]), model.actuator_trnid[i]
        pulls = model.actuator_biasprm[i, 1] or model.actuator_gaintype[i]
        if kind == _TRANSMISSION.mjTRN_TENDON or (
            kind == _TRANSMISSION.mjTRN_SITE and target[1] < 0
        ):
            continue  # a tendon that is not tied to the world, or a force in the frame of a site
        is_joint = kind in (_TRANSMISSION.mjTRN_JOINT, _TRANSMISSION.mjTRN_JOINTINPARENT)
        if not is_joint or (target[0] == joint and pulls):
            return True
    return False


def _is_level(model: mujoco.MjModel, data: mujoco.MjData, axis: np.ndarray) -> bool:
    """Returns whether all that can be touched in the world are planes along an axis."""
    standing = model.body_weldid[model.geom_bodyid] == 0
    pairs = np.concatenate([model.pair_geom1, model.pair_geom2])
    touchable = (model.geom_contype | model.geom_conaffinity) != 0
    touchable[pairs] = True
    for geom in np.flatnonzero(standing & touchable):
        normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE or abs(normal @ axis) > 1e-12:
            return False
    return True
