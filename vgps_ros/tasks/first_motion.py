# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The motion from which a task's first solve starts: drawn, held by a law, a path, or recorded."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path as FilePath
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import state_names
from vgps_ros.simulation.names import known, matching
from vgps_ros.tasks.motion_table import read_columns, read_rows, with_demonstration
from vgps_ros.tasks.sampled_motion import sampled_beginning
from vgps_ros.tasks.schema import Begin, Noise, Path, Pd, RecordedMotion, Sampling
from vgps_ros.tasks.task import Task, smoothed_noise
from vgps_ros.tasks.yaml_file import Document, Place

_MOST_DAMPING = 0.5  # of what stops a joint within one control; more makes a held torque unstable


def with_beginning(task: Task, begin: Begin, document: Document) -> Task:
    """Returns the task with the beginning that its file describes.

    Raises:
        InvalidInputError: the beginning does not fit the model.
    """
    shape = (task.planned_horizon, task.dynamics.control_dim)
    if isinstance(begin, RecordedMotion):
        path = document.file(("begin", "file"), begin.file)
        with document.at(("begin", "file")):
            return with_demonstration(task, path)
    if isinstance(begin, Pd):
        law = _pd_law(task, begin, document)
        return replace(task, demonstrate=partial(_executed, task.dynamics, law))
    if isinstance(begin, Sampling):
        return replace(task, demonstrate=sampled_beginning(task, begin, document))
    if isinstance(begin, Noise):
        std = np.array(begin.std)
        if std.size not in (1, shape[1]):
            raise document.error(
                ("begin", "std"),
                f"it has {std.size} values, but the model has {shape[1]} actuators.",
            )
        return replace(
            task,
            guess=partial(
                _noise, task.dynamics, shape, std, begin.time_constant / task.dynamics.time_step
            ),
        )
    task = replace(task, guess=lambda _: np.zeros(shape))
    if isinstance(begin, Path):
        return replace(task, path=path_states(task, begin, document))
    return task


def _noise(
    dynamics: Dynamics,
    shape: tuple[int, int],
    std: Array,
    time_constant: float,
    rng: np.random.Generator,
) -> Array:
    noise = std * smoothed_noise(rng, shape, 1.0, time_constant)
    return np.clip(noise, *dynamics.control_limits)


def _executed(
    dynamics: Dynamics, law: Callable[[int, Array], Array], start: Array, steps: int, *_: Any
) -> Trajectory:
    return dynamics.rollout(start, law, steps)


def _pd_law(task: Task, begin: Pd, document: Document) -> Callable[[int, Array], Array]:
    """Returns the law of controls that hold a pose; it maps states (N, n_x) to (N, n_u).

    A motor gets the torque stiffness · (pose − position) − damping · velocity. A servo of positions
    gets the pose itself.
    """
    model: mujoco.MjModel = task.dynamics.model
    data = mujoco.MjData(model)
    data.qpos[:] = task.initial_state[: model.nq]
    if begin.pose is not None:
        key = keyframe(model, begin.pose, document, ("begin", "pose"))
        data.qpos[:] = model.key_qpos[key]
    mujoco.mj_forward(model, data)
    joints = model.actuator_trnid[:, 0]
    single = model.jnt_type[joints] >= int(mujoco.mjtJoint.mjJNT_SLIDE)  # or a hinge
    of_joint = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & single
    joints = np.where(of_joint, joints, 0)
    places, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    mass = inertia[dofs, dofs]
    names = [model.joint(j).name for j in joints]
    weight = model.body_subtreemass[0] * np.linalg.norm(model.opt.gravity)
    suited = np.where(of_joint, weight * model.stat.extent / 4 + mass, 0.0)
    stiffness = _by_joint(begin.stiffness, suited, names, "stiffness", document)
    # The implicit part of the integration does not see these torques, so they must be mild.
    mild = np.minimum(2 * np.sqrt(stiffness * mass), _MOST_DAMPING * mass / task.dynamics.time_step)
    damping = _by_joint(begin.damping, mild, names, "damping", document)
    strength = model.actuator_gainprm[:, 0] * model.actuator_gear[:, 0]
    is_servo = model.actuator_biasprm[:, 1] != 0
    held = np.where(is_servo, data.actuator_length, 0.0)
    pose, limits = data.qpos[places].copy(), task.dynamics.control_limits

    def law(_: int, x: Array) -> Array:
        torques = stiffness * (pose - x[:, places]) - damping * x[:, model.nq + dofs]
        motors = np.where(of_joint & (strength != 0), torques / np.where(strength, strength, 1), 0)
        return np.clip(np.where(is_servo, held, motors), *limits)

    return law


def _by_joint(given: Any, default: Array, names: list[str], key: str, document: Document) -> Array:
    """Returns a value for each control: one for all, or by its joint's name or pattern."""
    if given is None:
        return default
    if not isinstance(given, dict):
        return np.full(len(names), float(given))
    values = default.copy()
    for pattern, value in given.items():
        with document.at(("begin", key, pattern)):
            found = matching("driven joint", pattern, names)
        values[[i for i, name in enumerate(names) if name in found]] = value
    return values


_PLACES = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_FREE)  # joints with lengths


def path_states(task: Task, begin: Path, document: Document) -> Array:
    """Returns the states of a path over the planned horizon, shape (T+1, n_x).

    Positions are those of the path, velocities are their differences over time, and activations
    are zero.

    Raises:
        InvalidInputError: the path names what the model or its file lacks.
    """
    if begin.file is None:
        states = _between_keyframes(task, begin, document)
    else:
        path = document.file(("begin", "file"), begin.file)
        with document.at(("begin", "file")):
            states = _recorded(task, path, begin.scale)
    n_q, n_v = task.dynamics.model.nq, task.dynamics.model.nv
    space, period = task.dynamics.space, task.dynamics.time_step
    moves = space.subtract(states[1:], states[:-1])[:, :n_v]
    states[:, n_q : n_q + n_v] = np.concatenate([moves, moves[-1:]]) / period
    return states


def _between_keyframes(task: Task, begin: Path, document: Document) -> Array:
    """Returns states on lines from the start through the keyframes, at even times."""
    model, space = task.dynamics.model, task.dynamics.space
    knots = [_at_rest(task)]
    for i, name in enumerate(begin.through):
        knot = knots[0].copy()
        knot[: model.nq] = model.key_qpos[keyframe(model, name, document, ("begin", "through", i))]
        knots.append(knot)
    when = np.linspace(0.0, len(knots) - 1.0, task.planned_horizon + 1)
    before = np.minimum(when.astype(int), max(len(knots) - 2, 0))
    after = np.minimum(before + 1, len(knots) - 1)
    origins, ends = np.stack(knots)[before], np.stack(knots)[after]
    return space.add(origins, (when - before)[:, None] * space.subtract(ends, origins))


def _recorded(task: Task, path: FilePath, scale: float) -> Array:
    """Returns states with the positions of a file, and the start's where it has none."""
    model = task.dynamics.model
    positions = state_names(model)[: model.nq]
    header, _ = read_rows(path)
    names = [name for name in positions if name in header]
    if not names:
        raise InvalidInputError(
            f"{path.name} has none of the columns {', '.join(positions)}; name them time and "
            "JOINT/position."
        )
    times = task.dynamics.time_step * np.arange(task.planned_horizon + 1)
    states = np.tile(_at_rest(task), (len(times), 1))
    columns = [positions.index(name) for name in names]
    lengths = {
        model.jnt_qposadr[joint] + i
        for joint in np.flatnonzero(np.isin(model.jnt_type, _PLACES))
        for i in range(3 if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE else 1)
    }
    factors = np.where(np.isin(columns, list(lengths)), scale, 1.0)
    states[:, columns] = factors * read_columns(path, names, times)
    for state in states:
        mujoco.mj_normalizeQuat(model, state[: model.nq])
    return states


def _at_rest(task: Task) -> Array:
    """Returns the start without its velocities and activations, shape (n_x,)."""
    state = task.initial_state.copy()
    state[task.dynamics.model.nq :] = 0.0
    return state


def keyframe(model: mujoco.MjModel, wanted: str | int, document: Document, place: Place) -> int:
    """Returns the number of a keyframe.

    Raises:
        InvalidInputError: the model has none of this name or number.
    """
    names = [model.key(i).name or str(i) for i in range(model.nkey)]
    with document.at(place):
        if isinstance(wanted, int) and wanted < model.nkey:
            return wanted
        return names.index(known("keyframe", str(wanted), names))
