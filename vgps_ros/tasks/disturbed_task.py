# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A task on another robot: under a disturbance, which may be drawn, or with closed loops.

The push is part of the dynamics, x_{t+1} = f_t(x_t, u_t), which are as deterministic as without it:
an optimisation knows when it comes, rollouts and derivatives contain it. A policy does not know it,
since what it reads has no time; it learns what each q(ζ) does after its push.

A slope is a turn of gravity, so that a cost's heights and directions still count from the ground;
directions that a policy measures count from the vertical, as by an inertial unit. Uneven ground
has ridges: long cylinders that lie across the way, nearly buried, whose tops are round, since force
must start smoothly where a foot touches them. Steps are boxes across the way, one up, one down.
"""

from dataclasses import replace
from functools import lru_cache

import mujoco
import numpy as np

from vgps_ros.core.checks import find_name
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import StateReadings
from vgps_ros.core.records import Array
from vgps_ros.robot.bodies import UP
from vgps_ros.simulation.compiled_states import BodyPush
from vgps_ros.simulation.controls import closed_loops
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import are_motors, compile_model
from vgps_ros.simulation.model_changes import name_all
from vgps_ros.simulation.readings import MEASURED, Readings
from vgps_ros.tasks.disturbance import Disturbance, DisturbanceSettings
from vgps_ros.tasks.task import Task

UNDISTURBED = Disturbance()


@lru_cache(maxsize=64)  # each solve of a search asks for the same ones
def disturb_task(task: Task, disturbance: Disturbance) -> Task:
    """Returns the task under a disturbance: the same start and cost, other dynamics.

    Raises:
        InvalidInputError: the disturbance does not suit the robot.
    """
    if not (any(disturbance.push) or disturbance.changes_model):
        return task
    model = task.dynamics.model
    body = body_number(task, disturbance.body)
    if disturbance.friction != 1.0 and not can_slide_on_ground(model):
        raise InvalidInputError(
            f"The friction of contacts shall change by the factor {disturbance.friction:.3g}, but "
            f"no two geoms of the robot of {task.name} can touch with friction; leave out "
            "disturb.friction or --frictions."
        )
    if disturbance.changes_model:
        model = _disturbed_model(task.mjcf, body_names(task.mjcf)[body], disturbance)
        task = on_dynamics(task, Dynamics(model, task.dynamics.substeps))
    if not any(disturbance.push):
        return task
    period = task.dynamics.time_step
    first = round(disturbance.push_time / period)
    steps = max(1, round(disturbance.push_duration / period))
    force = np.array([*disturbance.push, 0.0]) / (steps * period)
    push = BodyPush(body, first, first + steps, force)
    return replace(task, dynamics=task.dynamics.pushed(push))


def on_dynamics(task: Task, dynamics: Dynamics) -> Task:
    """Returns the task with other dynamics, whose states are of the same space."""

    def here(features: StateReadings, *, measured: bool = False) -> Readings:
        return Readings(dynamics.simulations, features.names, measured=measured)

    cost = task.cost
    if isinstance(cost.features, Readings):  # not those of a task in Python that has its own
        cost = replace(cost, features=here(cost.features))
    return replace(
        task,
        dynamics=dynamics,
        cost=cost,
        observation=replace(
            task.observation, readings=here(task.observation.readings, measured=True)
        ),
        fallen=replace(task.fallen, readings=here(task.fallen.readings)),
        limits=replace(task.limits, readings=here(task.limits.readings)),
    )


def with_servos(task: Task, stiffness: Array, damping: Array) -> Task:
    """Returns the task with servos in place of motors; see `simulation.controls.closed_loops`.

    No cost of the task scores their controls, which are targets of positions.

    Raises:
        InvalidInputError: a gain does not suit its actuator.
    """
    mjcf = closed_loops(task.mjcf, stiffness, damping)
    if mjcf == task.mjcf:
        return task
    cost = replace(task.cost, control_weights=np.zeros_like(stiffness))
    dynamics = Dynamics(compile_model(mjcf, is_tried=True), task.dynamics.substeps)
    return on_dynamics(replace(task, mjcf=mjcf, cost=cost), dynamics)


def draw_disturbance(
    task: Task, settings: DisturbanceSettings, rng: np.random.Generator
) -> Disturbance:
    """Draws a disturbance.

    Raises:
        InvalidInputError: there is no such body, or it cannot be pushed.
    """
    body = body_number(task, settings.body)
    time, angle, friction, slope, payload = rng.uniform(size=5)
    ahead = _direction(task, body, angle) if settings.push or settings.slope else np.zeros(2)
    ridges_seed = int(rng.integers(2**32)) if settings.ridges else 0
    damping, armature = 1.0, 1.0
    if settings.joints:
        damping, armature = (1.0 + settings.joints) ** rng.uniform(-1.0, 1.0, 2)
    return Disturbance(
        body=body_names(task.mjcf)[body],
        push=tuple((settings.push * ahead).tolist()),
        push_time=settings.push_before * time,
        push_duration=settings.push_duration,
        payload=settings.payload * payload,
        friction=1.0 + settings.friction * (2.0 * friction - 1.0),
        slope=tuple((settings.slope * (2.0 * slope - 1.0) * ahead).tolist()),
        ridges=settings.ridges,
        ridges_seed=ridges_seed,
        damping=float(damping),
        armature=float(armature),
        strength=1.0 - settings.strength * rng.uniform() if settings.strength else 1.0,
        steps=settings.steps * rng.uniform() if settings.steps else 0.0,
        gain=float((1.0 + settings.gain) ** rng.uniform(-1.0, 1.0)) if settings.gain else 1.0,
        friction_loss=settings.friction_loss * rng.uniform() if settings.friction_loss else 0.0,
    )


def body_number(task: Task, name: str) -> int:
    """Returns the number of the body of this name, or of the heaviest one if it is empty.

    Raises:
        InvalidInputError: there is no such body.
    """
    if not name:
        return int(np.argmax(task.dynamics.model.body_mass))
    names = body_names(task.mjcf)[1:]
    return 1 + names.index(find_name("body", name, names))


def _direction(task: Task, body: int, share: float) -> Array:
    """Returns a horizontal direction in which a body can be pushed, drawn by a share of 1."""
    model = task.dynamics.model
    data, jacobian = mujoco.MjData(model), np.zeros((3, model.nv))
    data.qpos[:] = task.initial_state[: model.nq]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    free = np.abs(jacobian[:2]).max(axis=1) > 1e-9
    if not free.any():
        name = body_names(task.mjcf)[body]
        raise InvalidInputError(
            f"The body '{name}' cannot move horizontally, so that no push moves it; name another "
            "one as disturb.body."
        )
    if free.all():
        return np.array([np.cos(2 * np.pi * share), np.sin(2 * np.pi * share)])
    return np.where(free, 1.0 if share < 0.5 else -1.0, 0.0)


_DISABLED = mujoco.mjtDisableBit
_SENSOR = mujoco.mjtSensor
_DIRECTIONS = (
    *(_SENSOR.mjSENS_FRAMEXAXIS, _SENSOR.mjSENS_FRAMEYAXIS, _SENSOR.mjSENS_FRAMEZAXIS),
    _SENSOR.mjSENS_FRAMEQUAT,
)
_FRAMES = ("objtype", "objname", "reftype", "refname")  # of a sensor, and in which it counts
_RADIUS = 0.5  # of a ridge's round top [m]
_SPACING = 0.6  # between two ridges, on average [m]
_REACH = (-5.0, 50.0)  # where there are ridges, ahead of the origin [m]
_HALF_WIDTH = 20.0  # of a ridge or step, across the way [m]
_ACROSS = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
_STEP = 0.4  # length of a step, and of the level ground between two [m]
_AHEAD = 0.4  # where the first step begins [m]
# What ridges and steps have of the floor.
_OF_FLOOR = (
    *("contype", "conaffinity", "condim", "priority", "solmix", "margin", "gap"),
    *("friction", "solref", "solimp", "rgba"),
)


def _disturbed_model(mjcf: str, body: str, disturbance: Disturbance) -> mujoco.MjModel:
    """Returns the model of an MJCF with a disturbance of a body, friction, the ground or joints."""
    spec = _named_model(mjcf)
    model = spec.compile()
    if payload := disturbance.payload:
        place, small = model.body(body).ipos, payload * np.full(3, 1e-6)
        load = spec.body(body).add_body(name=f"{body}_payload", pos=place, mass=payload)
        load.inertia, load.explicitinertial = small, True
    for geom in spec.geoms:
        geom.friction[0] *= disturbance.friction
    for pair in spec.pairs:
        pair.friction[:2] *= disturbance.friction
    for joint in spec.joints:
        joint.damping *= disturbance.damping
        joint.armature *= disturbance.armature
    if disturbance.strength != 1.0:
        _scale_forces(spec, model, disturbance.strength)
    driven = {actuator.target for actuator in spec.actuators}
    for joint in spec.joints:
        joint.frictionloss += disturbance.friction_loss * (joint.name in driven)
    for actuator in spec.actuators:
        actuator.gainprm[0] *= disturbance.gain
        actuator.biasprm[:3] *= disturbance.gain
    if any(disturbance.slope):
        _slope(spec, disturbance.slope)
    if disturbance.ridges or disturbance.steps:
        _raise_ground(spec, disturbance)
    return spec.compile()


@lru_cache(maxsize=8)  # each draw of a disturbance asks for them
def body_names(mjcf: str) -> list[str]:
    """Returns the name of each body of an MJCF, in MuJoCo's order; all have one."""
    model = _named_model(mjcf).compile()
    return [model.body(i).name for i in range(model.nbody)]


def can_slide_on_ground(model: mujoco.MjModel) -> bool:
    """Returns whether two geoms of a model may touch with friction by their bits."""
    if model.opt.disableflags & (_DISABLED.mjDSBL_CONTACT | _DISABLED.mjDSBL_CONSTRAINT):
        return False
    first, second = np.triu_indices(model.ngeom, 1)
    mask = model.geom_contype[first] & model.geom_conaffinity[second]
    mask |= model.geom_contype[second] & model.geom_conaffinity[first]
    rubs = np.maximum(model.geom_condim[first], model.geom_condim[second]) > 1
    touch = (mask != 0) & rubs
    return bool(touch.any() or (model.pair_dim > 1).any())


def _named_model(mjcf: str) -> mujoco.MjSpec:
    """Returns the model of an MJCF, whose bodies have names as those of a changed model do."""
    spec = mujoco.MjSpec.from_string(mjcf)
    name_all(spec)
    return spec


def _scale_forces(spec: mujoco.MjSpec, model: mujoco.MjModel, factor: float) -> None:
    """Multiplies the largest force of each actuator, and that of all actuators of a joint.

    That of a motor which only its control limits becomes a limit of its force.
    """
    motors = are_motors(model)
    limited = (model.actuator_forcelimited > 0) | (motors & (model.actuator_ctrllimited > 0))
    if not (limited.any() or model.jnt_actfrclimited.any()):
        raise InvalidInputError(
            f"The actuators' largest forces shall change by the factor {factor:.3g}, but no "
            "actuator has one; leave out disturb.strength or --strengths."
        )
    for i in np.flatnonzero(limited):
        largest = model.actuator_forcerange[i]
        if not model.actuator_forcelimited[i]:
            largest = np.sort(model.actuator_gainprm[i, 0] * model.actuator_ctrlrange[i])
        spec.actuators[i].forcelimited, spec.actuators[i].forcerange = 1, factor * largest
    for joint in spec.joints:
        joint.actfrcrange *= factor


def _slope(spec: mujoco.MjSpec, angles: tuple[float, float]) -> None:
    """Turns gravity as seen from ground that rises by these angles along x and y.

    Each sensor of a frame's direction in the world, or of the world's in a frame, gets another one
    beside it, which measures it from the vertical.
    """
    from scipy.spatial.transform import Rotation  # whose import would delay each node's start

    up = np.array([np.tan(angles[0]), np.tan(angles[1]), 1.0])
    up /= np.linalg.norm(up)
    spec.option.gravity = -np.linalg.norm(spec.option.gravity) * up
    turn = Rotation.align_vectors(up, UP)[0].as_quat(scalar_first=True)
    level = spec.worldbody.add_site(name=f"{MEASURED}level", quat=turn, group=5)
    of_level = mujoco.mjtObj.mjOBJ_SITE, level.name
    for sensor in [each for each in spec.sensors if each.type in _DIRECTIONS and each.name]:
        same = {key: getattr(sensor, key) for key in ("type", *_FRAMES, "cutoff")}
        other = spec.add_sensor(name=MEASURED + sensor.name, **same)
        if sensor.objname == "world":
            other.objtype, other.objname = of_level
        if sensor.refname in ("", "world"):
            other.reftype, other.refname = of_level


def _raise_ground(spec: mujoco.MjSpec, disturbance: Disturbance) -> None:
    """Adds ridges and steps, which rub and give way as the floor does."""
    planes = [g for g in spec.geoms if g.type == mujoco.mjtGeom.mjGEOM_PLANE]
    if not planes:
        raise InvalidInputError(
            "The model has no floor that could be uneven; leave out disturb.ridges and "
            "disturb.steps, or add a floor (changes: floor)."
        )
    floor, raised = planes[0], []
    if disturbance.ridges:
        rng = np.random.default_rng(disturbance.ridges_seed)
        for i, x in enumerate(np.arange(*_REACH, _SPACING)):
            top = disturbance.ridges * rng.uniform()
            ridge = spec.worldbody.add_geom(name=f"ridge_{i}", quat=_ACROSS)
            ridge.type, ridge.size = mujoco.mjtGeom.mjGEOM_CYLINDER, [_RADIUS, _HALF_WIDTH, 0.0]
            ridge.pos = [x + _SPACING * rng.uniform(-0.4, 0.4), 0.0, top - _RADIUS]
            raised.append(ridge)
    if disturbance.steps:
        for i, x in enumerate(np.arange(_AHEAD, _REACH[1], 2.0 * _STEP)):
            step = spec.worldbody.add_geom(name=f"step_{i}", pos=[x + 0.5 * _STEP, 0.0, 0.0])
            step.type = mujoco.mjtGeom.mjGEOM_BOX
            step.size = [0.5 * _STEP, _HALF_WIDTH, disturbance.steps]
            raised.append(step)
    for geom in raised:
        geom.pos += floor.pos
        for name in _OF_FLOOR:
            setattr(geom, name, getattr(floor, name))
