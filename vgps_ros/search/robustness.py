# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The share of a policy's rollouts that survive disturbances, from pushes to noise of sensors."""

import math
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from functools import cache
from itertools import takewhile
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.cores import count_cores
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.core.slow_steps import progress_lines
from vgps_ros.robot.executed_control import Driver
from vgps_ros.search.judgement import (
    PUSHES,
    SENSORS,
    Behaviour,
    Trial,
    behaviour,
    check_lengths,
    execute_trial,
    figures,
)
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import sensor_numbers
from vgps_ros.tasks import Task
from vgps_ros.tasks.disturbance import Disturbance, DisturbanceSettings
from vgps_ros.tasks.disturbed_task import (
    UNDISTURBED,
    body_number,
    can_slide_on_ground,
    disturb_task,
    draw_disturbance,
    on_dynamics,
)

ENOUGH = 0.9  # share of the rollouts that survive what a policy is said to bear

# Each kind of disturbance, with its name on an axis.
KINDS = {
    "pushes": "impulse [N·s]",
    "slopes": "slope, upwards [rad]",
    "ridges": "largest height of ridges [m]",
    "steps": "height of steps [m]",
    "payloads": "payload [kg]",
    "masses": "factor on the body's mass",
    "frictions": "factor on friction",
    "dampings": "factor on the joints' damping",
    "armatures": "factor on the joints' armature",
    "strengths": "factor on the largest forces",
    "latencies": "latency [s]",
    "sensor_noise": "factor on usual sensor noise",
    "contacts": "contacts: 0 the model's, 1 MuJoCo's",
    "engines": "engine: 0 the model's, 1 another",
}
# Those that change nothing where they are 1, the others at 0.
_FACTORS = ("masses", "frictions", "dampings", "armatures", "strengths")
# What some of them are called in a disturbance.
_IN_DISTURBANCE = {"ridges": "ridges", "steps": "steps", "strengths": "strength"}
_IN_DISTURBANCE |= {"payloads": "payload", "frictions": "friction"}
_IN_DISTURBANCE |= {"dampings": "damping", "armatures": "armature"}
_IN_JOINTS = {"dampings": "dof_damping", "armatures": "dof_armature"}  # of MuJoCo's model

# Tried on a robot that obeys commands where nothing else is asked for, beside no disturbance.
USUAL = {
    "pushes": (0.0, 10.0, 20.0, 25.0, 30.0, 40.0),
    "slopes": (0.0, 0.13, 0.26),
    "ridges": (0.0, 0.04),
    "steps": (0.0, 0.04),
    "masses": (0.6, 1.0, 1.4),
    "frictions": (0.4, 0.7, 1.0, 1.2),
    "dampings": (0.5, 1.0, 2.0),
    "armatures": (0.5, 1.0, 2.0),
    "latencies": (0.0, 0.02),
    "sensor_noise": (0.0, 1.0),
    "contacts": (0, 1),
    "engines": (0, 1),
}

# Standard deviations of the noise of usual sensors: encoders, an inertial unit, an estimated speed.
_ANGLE, _ANGULAR_VELOCITY = 0.01, 0.5  # of a joint that turns [rad, rad/s]
_PLACE, _VELOCITY = 0.01, 0.1  # of a joint that slides, or of a frame [m, m/s]
_SENSOR = mujoco.mjtSensor
_SENSOR_STD = {
    _SENSOR.mjSENS_GYRO: 0.1,  # [rad/s]
    _SENSOR.mjSENS_FRAMEANGVEL: 0.1,
    _SENSOR.mjSENS_VELOCIMETER: _VELOCITY,
    _SENSOR.mjSENS_FRAMELINVEL: _VELOCITY,
    _SENSOR.mjSENS_SUBTREELINVEL: _VELOCITY,
    _SENSOR.mjSENS_FRAMEPOS: _PLACE,
    _SENSOR.mjSENS_SUBTREECOM: _PLACE,
    _SENSOR.mjSENS_FRAMEXAXIS: 0.03,  # a direction, such as gravity's
    _SENSOR.mjSENS_FRAMEYAXIS: 0.03,
    _SENSOR.mjSENS_FRAMEZAXIS: 0.03,
    _SENSOR.mjSENS_FRAMEQUAT: 0.015,  # half the angle
    _SENSOR.mjSENS_BALLQUAT: _ANGLE / 2,
    _SENSOR.mjSENS_BALLANGVEL: _ANGULAR_VELOCITY,
}
_COORDINATE_STD = {"vx": _VELOCITY, "vy": _VELOCITY, "vz": _VELOCITY}
_COORDINATE_STD |= {"x": _PLACE, "y": _PLACE, "z": _PLACE}
_COORDINATE_STD |= dict.fromkeys(("qw", "qx", "qy", "qz"), 0.015)  # gravity's direction: 0.03
_COORDINATE_STD |= {"wx": 0.1, "wy": 0.1, "wz": 0.1}


def robustness(
    task: Task,
    driver: Driver,
    trial: Trial,
    values: Mapping[str, Sequence[float]],
    seed: int,
    settings: DisturbanceSettings,
) -> dict[str, Any]:
    """Tries disturbances of several sizes.

    Args:
        task: the undisturbed robot.
        driver: the policy, with what it reads.
        trial: the rollouts in which each disturbance is tried, the same ones for all of them.
        values: sizes to try of each kind; see `KINDS`.
        seed: of the pushes' times and directions, and of the sensors' noise.
        settings: the body, and when and for how long it is pushed.

    Returns:
        By kind: the values in order, the share of rollouts that survive each, and between which
        values it is `ENOUGH`; None where not even so many survive without a disturbance; `fallen`:
        the rollouts that do not survive each, as `replay_rollout` counts them. Of a task
        with commands also the intervals of the shares, the same for the rollouts that obey, and by
        command the root mean square errors; see `judge_controller`.

    Raises:
        InvalidInputError: the task does not say what a fall is and has no commands, the rollouts
            are too short to judge commands, or a disturbance does not suit the robot.
    """
    if not (task.fallen.lowest.size or task.signals.commands):
        raise InvalidInputError(
            f"The task {task.name} does not say when the robot has fallen, so that survival tells "
            "nothing; add `fallen` to its file."
        )
    for kind in _IN_JOINTS.keys() & values.keys():
        if not suits(task, kind):
            raise InvalidInputError(
                f"No joint of the robot of {task.name} has {_IN_DISTURBANCE[kind]}, so that "
                f"factors on it change nothing; leave out --{kind}."
            )
    body_number(task, settings.body)
    check_lengths(task, trial.noise.shape[1] * task.dynamics.time_step)

    @cache  # each kind is tried without a disturbance too, which is the same for all kinds
    def tried(kind: str, value: float) -> dict[str, Any]:
        here, given, own = _disturbed(task, driver, kind, value, trial, seed, settings)
        each = behaviours(here, driver, own or [UNDISTURBED] * len(given.starts), given)
        return figures(task, each) | {"fallen": np.flatnonzero(~each.up[:, -1]).tolist()}

    found: dict[str, dict[str, Any]] = {}
    report = progress_lines(f"Tries disturbances on {task.name}")
    count, done = sum(map(len, values.values())), 0
    for kind, given in values.items():
        ordered, calm = sorted(given), float(kind in _FACTORS)
        each = []
        for value in ordered:
            each.append(tried("", 0.0) if value == calm else tried(kind, value))
            done += 1
            report(done / count)
        found[kind] = {"values": ordered, "fallen": [one["fallen"] for one in each]}
        judged = {"survival": "borne"}
        if task.signals.commands:
            judged["obeys"] = "obeyed"
            found[kind] |= {key: [one[key] for one in each] for key in ("rms", "mean")}
        for share, enough in judged.items():
            shares = [one[share][-1] for one in each]
            is_calm_enough = tried("", 0.0)[share][-1] >= ENOUGH
            found[kind] |= {
                share: shares,
                enough: _tolerated_pushes(ordered, shares, calm) if is_calm_enough else None,
            }
            if task.signals.commands:
                found[kind][f"{share}_interval"] = [one[f"{share}_interval"][-1] for one in each]
    return found


def replay_rollout(
    task: Task,
    driver: Driver,
    trial: Trial,
    seed: int,
    settings: DisturbanceSettings,
    kind: str,
    value: float,
    rollout: int,
) -> Array:
    """Returns the states of one of the rollouts of `robustness`, shape (T+1, n_x)."""
    here, given, own = _disturbed(task, driver, kind, value, trial, seed, settings)
    here = disturb_task(here, own[rollout]) if own else here
    return execute_trial(here, driver, given.of([rollout]))[0][0]


def suits(task: Task, kind: str, body: str = "") -> bool:
    """Returns whether a kind of disturbance can be tried on a robot at all."""
    if kind in ("frictions", "contacts"):
        return can_slide_on_ground(task.dynamics.model)
    if kind in _IN_JOINTS:
        return bool(getattr(task.dynamics.model, _IN_JOINTS[kind]).any())
    if kind == "slopes":
        return bool(task.dynamics.model.opt.gravity.any())
    if kind in ("ridges", "steps"):
        return bool((task.dynamics.model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any())
    if kind == "pushes":
        try:
            settings = DisturbanceSettings(body=body, push=1.0)
            draw_disturbance(task, settings, np.random.default_rng(0))
        except InvalidInputError:
            return False
    return True


def behaviours(
    task: Task, driver: Driver, disturbances: Sequence[Disturbance], trial: Trial
) -> Behaviour:
    """Returns what each rollout does under its disturbance."""
    rows: dict[Disturbance, list[int]] = {}
    for i, disturbance in enumerate(disturbances):
        rows.setdefault(disturbance, []).append(i)
    seconds = trial.noise.shape[1] * task.dynamics.time_step

    def tried(disturbance: Disturbance) -> Behaviour:
        here = disturb_task(task, disturbance)
        return behaviour(here, driver, trial.of(rows[disturbance]), (seconds,))

    with ThreadPoolExecutor(count_cores()) as pool:
        found = Behaviour.joined(list(pool.map(tried, rows)))
    return found.of(np.argsort(np.concatenate([*rows.values()])))


def usual_noise(task: Task, driver: Driver) -> Array:
    """Returns the standard deviations of usual sensors for what a policy reads, shape (r,).

    Encoders: 0.01 rad and 0.5 rad/s of joints that turn, 0.01 m and 0.1 m/s of joints that slide.
    An inertial unit: 0.1 rad/s, and 0.03 of directions such as gravity's. An estimated velocity:
    0.1 m/s. Other numbers have no noise.
    """
    model = task.dynamics.model
    numbers = sensor_numbers(model)
    slides = {
        model.joint(i).name for i in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
    }

    def std(name: str) -> float:
        if name in numbers:
            sensor = numbers[name][0]
            kind = _SENSOR(model.sensor_type[sensor])
            if kind in (_SENSOR.mjSENS_JOINTPOS, _SENSOR.mjSENS_JOINTVEL):
                joint = model.joint(model.sensor_objid[sensor]).name
                what = "position" if kind == _SENSOR.mjSENS_JOINTPOS else "velocity"
                return std(f"{joint}/{what}")
            return _SENSOR_STD.get(kind, 0.0)
        joint, _, what = name.rpartition("/")
        if what in ("position", "sin", "cos"):
            return _PLACE if joint in slides else _ANGLE
        if what == "velocity":
            return _VELOCITY if joint in slides else _ANGULAR_VELOCITY
        return _COORDINATE_STD.get(what, 0.0)

    return np.array([std(name) for name in driver.observation.readings.names])


def _disturbed(
    task: Task,
    driver: Driver,
    kind: str,
    value: float,
    given: Trial,
    seed: int,
    settings: DisturbanceSettings,
) -> tuple[Task, Trial, list[Disturbance]]:
    """Returns the robot, the rollouts, and what disturbs each of these by itself, if anything.

    The kind is empty where there is no disturbance.
    """
    rngs = [generator(seed, Stream.JUDGEMENT, PUSHES, i) for i in range(len(given.starts))]
    if kind == "pushes":  # times and directions are the same for all sizes
        pushed = replace(settings, push=value)
        return task, given, [draw_disturbance(task, pushed, rng) for rng in rngs]
    if kind == "slopes" and task.signals.commands:  # which lead it in all directions
        turns = [2.0 * np.pi * rng.uniform() for rng in rngs]
        leaning = [Disturbance(slope=(value * np.cos(a), value * np.sin(a))) for a in turns]
        return task, given, leaning
    body, here = settings.body, task
    if kind == "slopes":
        here = disturb_task(task, Disturbance(slope=(value, 0.0)))
    elif kind in _IN_DISTURBANCE:
        changed: dict[str, Any] = {_IN_DISTURBANCE[kind]: value}
        here = disturb_task(task, Disturbance(body=body, **changed))
    elif kind == "masses":
        here = _heavier(task, body_number(task, body), value)
    elif kind == "contacts":
        here = _with_default_contacts(task)
    elif kind == "engines":
        here = _by_another_engine(task)
    elif kind == "latencies":
        given = replace(given, lag=math.ceil(value / task.dynamics.time_step - 1e-6))
    elif kind == "sensor_noise":
        rng = generator(seed, Stream.JUDGEMENT, SENSORS)
        std = usual_noise(task, driver)
        drawn_noise = rng.standard_normal((*given.noise.shape[:2], len(std)))
        given = replace(given, misread=value * std * drawn_noise)
    return here, given, []


def _heavier(task: Task, body: int, factor: float) -> Task:
    """Returns the task where the mass and the inertia of a body are multiplied."""
    model = copy(task.dynamics.model)
    model.body_mass[body] *= factor
    model.body_inertia[body] *= factor
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return on_dynamics(task, Dynamics(model, task.dynamics.substeps))


def _with_default_contacts(task: Task) -> Task:
    """Returns the task where contacts are as hard as MuJoCo's are by default."""
    if not can_slide_on_ground(task.dynamics.model):
        raise InvalidInputError(
            f"The contacts shall be MuJoCo's, but no two geoms of the robot of {task.name} can "
            "touch with friction; leave out --contacts."
        )
    model, default = copy(task.dynamics.model), mujoco.MjSpec().worldbody.add_geom()
    model.geom_solref[:], model.geom_solimp[:] = default.solref, default.solimp
    model.pair_solref[:], model.pair_solimp[:] = default.solref, default.solimp
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
    return on_dynamics(task, Dynamics(model, task.dynamics.substeps))


def _by_another_engine(task: Task) -> Task:
    """Returns the task where MuJoCo computes otherwise, and with half the time step.

    Cones of friction are elliptic, not pyramids, or the other way round, the solver takes conjugate
    gradients, and the integrator is Euler's.
    """
    model = copy(task.dynamics.model)
    elliptic, pyramidal = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtCone.mjCONE_PYRAMIDAL
    model.opt.cone = pyramidal if model.opt.cone == elliptic else elliptic
    model.opt.solver = mujoco.mjtSolver.mjSOL_CG
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.timestep *= 0.5
    return on_dynamics(task, Dynamics(model, 2 * task.dynamics.substeps))


def _tolerated_pushes(values: Sequence[float], shares: Sequence[float], calm: float) -> list[float]:
    """Returns the range around no disturbance, which is borne, in which all values are borne."""
    pairs = list(zip(values, shares, strict=True))

    def end(pairs: Iterable[tuple[float, float]]) -> float:
        """Returns the last value before the first one that is not borne."""
        return [calm, *(v for v, _ in takewhile(lambda pair: pair[1] >= ENOUGH, pairs))][-1]

    return [end(p for p in reversed(pairs) if p[0] <= calm), end(p for p in pairs if p[0] >= calm)]
