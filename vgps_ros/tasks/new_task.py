# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a first task file for a robot, with comments that say what to change.

What the robot is for follows from its tree of bodies, its base, its mass and its actuators; names
count only where one says `target`. What it does not know, the file says.
"""

import json
import re
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.controls import ControlKind, Mask
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import cyclic_positions, deviation_names, joint_names
from vgps_ros.tasks.builder import exchanged

_UNKNOWN_REACH = 0.8  # of a servo whose force has no limit: the target at which it is strong [rad]
_DENSE = 100.0  # density from which on a medium is a liquid [kg/m³]
_NEAR = 2.0  # body lengths within which a swimmer is sent to a target
_FREE, _BALL, _SLIDE, _HINGE = range(4)  # as in mjtJoint

_LEGS = """optimizer: {ddp.regularization_floor: 0.1, policy_samples: 4, first_tolerance: 0.01}
search:                       # as of the built-in quadruped; `vgps train --help` says what each is
  hidden_units: [64, 64]
  iterations: 22
  situations: 24
  alphas: [0.4, 1.2]
  initial_ddp_iterations: 25
  policy_rollouts: 3
  evaluation_rollouts: 1
  fit: {iterations: 40, samples_per_step: 4, retries: 2, replayed: 0.4, late: 0.2}
  ddp_iterations: 2"""


@dataclass
class _Robot:
    """Facts about a model from which its first task file is written."""

    model: mujoco.MjModel
    data: mujoco.MjData  # at the start
    root: int  # the body that carries all others
    base: list[int]  # the joints that carry the whole robot along
    driven: set[int]  # the degrees of freedom that the actuators move
    gravity: float  # [m/s²]
    kind: str = "arm"
    feet: list[int] = field(default_factory=list)  # a geom of each, by the angle around the robot
    height: float = 0.0  # of the root above the ground [m]; 0 if it cannot rise or fall
    forward: tuple[str, float] = ("x", 1.0)  # the axis along which it goes, and in which direction
    start: dict[str, Any] = field(default_factory=dict)  # positions that differ
    goal: Array = field(default_factory=lambda: np.empty(0))  # qpos
    key: int | None = None

    @property
    def leg(self) -> float:
        """The height of its hips [m], by which speeds, steps and weights scale."""
        first = (_bending(self, leg)[:1] for leg in _legs(self))
        hips = [self.data.xanchor[j][2] for joints in first for j in joints]
        return max([h - _ground(self.model, self.data) for h in hips], default=self.height)

    @property
    def name(self) -> str:
        """The root's name."""
        return str(self.model.body(self.root).name)

    @property
    def is_free(self) -> bool:
        """Whether it has a free joint."""
        return any(self.model.jnt_type[j] == _FREE for j in self.base)

    @property
    def joints(self) -> list[int]:
        """The hinges and slides of its tree that are not its base."""
        kinds, bodies = self.model.jnt_type, self.model.jnt_bodyid
        own = np.flatnonzero((kinds >= _SLIDE) & self.in_tree(bodies))
        return [int(j) for j in own if j not in self.base]

    def in_tree(self, bodies: Any) -> Mask:
        """Returns which of the bodies are the robot's."""
        found: Mask = self.model.body_treeid[bodies] == self.model.body_treeid[self.root]
        return found


def first_task_file(reference: str, model: mujoco.MjModel, schema: str, dropped: list[str]) -> str:
    """Returns the text of a task file for a model, all of whose joints and actuators have names.

    The file names the model by the reference, and a JSON schema by its path, for editors; `dropped`
    is what had to be left out of the model, as `changes: {drop: ...}` has it.

    Raises:
        InvalidInputError: no actuator drives a joint, and no joint could have one.
    """
    robot = _robot(model)
    step = max(0.005, model.opt.timestep) if robot.feet else model.opt.timestep
    period = _whole(0.02 if robot.feet else 0.01, step)
    horizon = 1.0 if robot.feet else 4.0 if robot.kind == "pendulum" else 2.0
    names = {
        "Joints": [model.joint(i).name for i in range(model.njnt)],
        "Actuators": [model.actuator(i).name for i in range(model.nu)],
        "Keyframes": [model.key(i).name or str(i) for i in range(model.nkey)],
        "Sensors": [model.sensor(i).name for i in range(model.nsensor)],
    }
    lines = [
        f"# yaml-language-server: $schema={schema}",
        f"# {_described(robot)}",
        *(f"# {what}: {', '.join(filter(None, each)) or 'none'}." for what, each in names.items()),
        "# After a change, `vgps check task.yaml` says what looks wrong.",
        f"model: {reference}",
        *_changes(robot, step, dropped),
        f"control_period: {period:g}      # [s], multiple of the time step, {step:g}",
        f"horizon: {_whole(horizon, period):<5g}             # [s], trained on and scored",
    ]
    if robot.base:
        lines.append(f"lookahead: {_whole(0.5, period):<5g}           # [s], optimised beyond it")
    lines += [*_start(robot), *_signals(robot), *_sensors(robot), *_cost(robot), *_observed(robot)]
    fallen = [{"sensor": _new(robot, "height"), "index": "z", "below": 0.55 * robot.height}]
    if _leans(robot) and _up(robot)[2] > 0.9:  # by 60°
        fallen.append({"sensor": _new(robot, "up"), "index": "z", "below": 0.5})
    if robot.height:
        lines += ["fallen:", *(f"  - {_flow(limit)}" for limit in fallen)]
    lines.append(_begin(robot))
    if robot.feet:
        limit: dict[str, Any] = {"position": 0.3, "velocity": 2.0}
        limit["overrides"] = dict.fromkeys(_places(robot), np.inf)
        push = (3.0 if len(robot.feet) > 2 else 1.0) * model.body_subtreemass[robot.root]
        renew = {"share": 0.34, "push": float(f"{push:.2g}"), "pushed": 0.7, "ddp_iterations": 16}
        lines += [f"marginals: {_flow({'std_limit': limit})}", *_LEGS.splitlines()]
        lines += [f"  renew: {_flow(renew)}", "  commands: {still: 0.15}"]
    else:
        lines += [
            "search:                     # a smaller network learns faster, and may miss a contact",
            "  {hidden_units: [32], ddp_iterations: 5}",
        ]
    return "\n".join(lines) + "\n"


def _whole(duration: float, period: float) -> float:
    """Returns the multiple of a period that is nearest to a duration [s]."""
    return max(1, round(duration / period)) * period


def _flow(value: Any) -> str:
    """Returns a value as YAML has it on one line, with three digits of a number."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_flow(k)}: {_flow(v)}' for k, v in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_flow, value))}]"
    if isinstance(value, str):
        is_plain = re.fullmatch(r"(?!(on|off|yes|no|true|false|null)$)[A-Za-z_][\w/.-]*", value)
        return value if is_plain else json.dumps(value)
    return ".inf" if value == np.inf else f"{float(f'{value + 0.0:.3g}'):g}"


def _robot(model: mujoco.MjModel) -> _Robot:
    """Returns the facts about a model; its kind decides how it starts, and what its goal is."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    driven = {int(i) for i in data.moment_colind[: int(data.moment_rownnz.sum())]}
    singles = [j for j in range(model.njnt) if model.jnt_type[j] in (_SLIDE, _HINGE)]
    single = {int(model.jnt_dofadr[j]) for j in singles}
    if not driven and not singles:
        raise InvalidInputError(
            "--model: no actuator drives a joint, and there is no hinge or slide that a motor "
            "could drive; name a model of a robot."
        )
    dofs = [*(driven or single)]
    trees = model.dof_treeid[dofs]
    tree = int(np.bincount(trees[trees >= 0]).argmax())
    root = int(np.flatnonzero(model.body_treeid == tree)[0])
    first = [int(j) for j in model.body_jntadr[root] + np.arange(model.body_jntnum[root])]
    base = [j for j in first if model.jnt_dofadr[j] not in driven]
    travels = any(model.jnt_type[j] in (_FREE, _SLIDE) for j in base)
    if not travels or (not model.nu and len(first) == 1 and model.jnt_type[first[0]] != _FREE):
        base = []
    flags = model.opt.disableflags
    gravity = 0.0 if flags & mujoco.mjtDisableBit.mjDSBL_GRAVITY else -float(model.opt.gravity[2])
    robot = _Robot(model, data, root, base, driven or single, abs(gravity))
    ups = [_reset(robot, i)[root].reshape(3, 3)[2, 2] for i in range(model.nkey)]
    key = int(np.round(ups, 1).argmax()) if ups else None
    robot.key = None if key is None or np.allclose(model.key_qpos[key], model.qpos0) else key
    _reset(robot, robot.key)
    liquid = model.opt.density > _DENSE or model.opt.viscosity > 1e-3
    rises = any(
        model.jnt_type[j] == _FREE or (model.jnt_type[j] == _SLIDE and abs(data.xaxis[j][2]) > 0.5)
        for j in base
    )
    if base and liquid:
        robot.kind = "swimmer"
    elif base:
        robot.kind = "vehicle"
        if rises and robot.gravity:
            _stand(robot)
    elif robot.gravity and any(_hangs(robot, j) for j in robot.joints):
        robot.kind = "pendulum"
    _turn(robot)
    _set_goal(robot)
    return robot


def _reset(robot: _Robot, key: int | None) -> Array:
    """Sets the data to a keyframe, or to the model's own start; returns the bodies' frames."""
    if key is None:
        mujoco.mj_resetData(robot.model, robot.data)
    else:
        mujoco.mj_resetDataKeyframe(robot.model, robot.data, key)
    mujoco.mj_forward(robot.model, robot.data)
    return np.array(robot.data.xmat)


def _hangs(robot: _Robot, joint: int) -> bool:
    """Returns whether nothing but gravity moves a hinge of the robot: no motor, spring or loop."""
    model = robot.model
    tied = {int(i) for i in [*model.eq_obj1id, *model.eq_obj2id]} if model.neq else set()
    return bool(
        model.jnt_type[joint] == _HINGE
        and model.jnt_dofadr[joint] not in robot.driven
        and not np.any(model.jnt_stiffness[joint])
        and joint not in tied
    )


def _stand(robot: _Robot) -> None:
    """Sets the start of a robot that gravity holds on the ground: within its limits, knees bent.

    Its feet are what of its outermost bodies is lowest.
    """
    model, data = robot.model, robot.data
    original = data.qpos.copy()
    for j in robot.joints:
        place, (low, high) = model.jnt_qposadr[j], model.jnt_range[j]
        if model.jnt_limited[j] and not low - 1e-6 <= data.qpos[place] <= high + 1e-6:
            share = 0.25 * (high - low)  # of its range, inside which it starts
            data.qpos[place] = np.clip(data.qpos[place], low + share, high - share)
    mujoco.mj_forward(model, data)
    robot.feet = _feet(robot)
    _bend(robot, original)
    robot.feet = _feet(robot)
    depth, lowest = _depth(robot)
    vertical = [
        model.jnt_qposadr[j] + 2 * (model.jnt_type[j] == _FREE)
        for j in robot.base
        if model.jnt_type[j] == _FREE or abs(data.xaxis[j][2]) > 0.5
    ]
    hovers = robot.feet and 0.01 < -depth < 2.0 * (data.xpos[robot.root][2] - lowest)
    if depth > 1e-3 or hovers:
        data.qpos[vertical[0]] += depth
        mujoco.mj_kinematics(model, data)
    mujoco.mj_forward(model, data)
    reset = mujoco.MjData(model)
    if robot.key is not None:
        mujoco.mj_resetDataKeyframe(model, reset, robot.key)
    for j in range(model.njnt):
        first = int(model.jnt_qposadr[j])
        place = slice(first, first + {_FREE: 7, _BALL: 4}.get(int(model.jnt_type[j]), 1))
        if not np.allclose(data.qpos[place], reset.qpos[place], atol=1e-4):
            values = [round(float(v), 4) for v in data.qpos[place]]
            robot.start[model.joint(j).name] = values if len(values) > 1 else values[0]
    robot.height = float(data.xpos[robot.root][2] - _ground(model, data))
    if robot.feet:
        robot.kind = "legs"


def _touching(model: mujoco.MjModel) -> Mask:
    found: Mask = (model.geom_contype | model.geom_conaffinity) != 0
    found[np.concatenate([model.pair_geom1, model.pair_geom2]).astype(int)] = True
    return found


def _ground(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Returns the height of the model's level planes, or 0 [m]."""
    planes = _touching(model) & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    planes &= data.geom_xmat[:, 8] > 0.9
    return float(data.geom_xpos[planes, 2].max(initial=0.0))


def _bottoms(robot: _Robot) -> Array:
    """Returns the height of each geom's lowest point, inf if it touches nothing, shape (ngeom,)."""
    model, data = robot.model, robot.data
    lowest = np.full(model.ngeom, np.inf)
    for i in np.flatnonzero(_touching(model) & robot.in_tree(model.geom_bodyid)):
        axes, size = data.geom_xmat[i].reshape(3, 3)[2], model.geom_size[i]
        kind = mujoco.mjtGeom(model.geom_type[i])
        if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
            reach = size[0] + size[1] * abs(axes[2]) * (kind == mujoco.mjtGeom.mjGEOM_CAPSULE)
            lowest[i] = data.geom_xpos[i, 2] - reach
        else:  # at most as far as its box
            centre, half = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
            lowest[i] = data.geom_xpos[i, 2] + axes @ centre - np.abs(axes) @ half
    return lowest


def _depth(robot: _Robot) -> tuple[float, float]:
    """Returns how far a robot reaches below its ground [m], and the height of its lowest point."""
    lowest = float(_bottoms(robot).min(initial=np.inf))
    ground = _ground(robot.model, robot.data)
    depth = float(np.ceil(1e3 * (ground - lowest)) / 1e3) if np.isfinite(lowest) else 0.0
    return depth, min(lowest, ground + 1e9)


def _feet(robot: _Robot) -> list[int]:
    """Returns a geom of each foot, by the angle around the robot, the left front one first."""
    model, data = robot.model, robot.data
    bottoms = _bottoms(robot)
    lowest = float(bottoms.min(initial=np.inf))
    parents = {
        int(model.body_parentid[model.geom_bodyid[i]]) for i in np.flatnonzero(np.isfinite(bottoms))
    }
    high = data.xpos[robot.root][2] - lowest
    found = {}
    for body in map(int, np.flatnonzero(robot.in_tree(np.arange(model.nbody)))):
        own = np.flatnonzero((model.geom_bodyid == body) & np.isfinite(bottoms))
        if not own.size or body in parents or body == robot.root:
            continue
        if bottoms[own].min() < lowest + 0.1 * high and not _is_wheel(robot, body, own):
            soles = own[bottoms[own] < bottoms[own].min() + 0.005]
            middle = data.geom_xpos[soles].mean(axis=0)
            nearest = np.abs(data.geom_xpos[soles] - middle).sum(axis=1).argmin()
            found[int(model.body_parentid[body])] = int(soles[nearest])
    for parent, geom in list(found.items()):  # what is above a foot on the same leg is none
        for other in [g for p, g in found.items() if p != parent]:
            under = int(model.geom_bodyid[other])
            while under not in (parent, robot.root):
                under = int(model.body_parentid[under])
            if under == parent != robot.root and bottoms[geom] > bottoms[other] + 0.01:
                found.pop(parent, None)
    centre = data.subtree_com[robot.root] if robot.base else data.xpos[robot.root]
    around = {i: np.arctan2(*(data.geom_xpos[i] - centre)[[1, 0]]) for i in found.values()}
    return sorted(around, key=lambda i: around[i] % (2 * np.pi))


def _is_wheel(robot: _Robot, body: int, geoms: Any) -> bool:
    """Returns whether a body turns about its own middle, without end."""
    model, data = robot.model, robot.data
    joint = int(model.body_jntadr[body])
    if joint < 0 or model.jnt_type[joint] != _HINGE or model.jnt_limited[joint]:
        return False
    arms = np.cross(data.geom_xpos[geoms] - data.xanchor[joint], data.xaxis[joint])
    return bool(np.linalg.norm(arms, axis=1).max() < 0.1 * model.geom_rbound[geoms].max())


def _legs(robot: _Robot) -> list[list[int]]:
    """Returns the hinges of each foot's leg, the hip's first; not what two feet share."""
    model, chains = robot.model, list[list[int]]()
    for foot in robot.feet:
        body, chain = int(model.geom_bodyid[foot]), list[int]()
        while body != robot.root:
            own = [j for j in robot.joints if model.jnt_bodyid[j] == body]
            chain = [j for j in own if model.jnt_type[j] == _HINGE] + chain
            body = int(model.body_parentid[body])
        chains.append(chain)
    return [[j for j in chain if sum(j in other for other in chains) == 1] for chain in chains]


def _bending(robot: _Robot, leg: list[int]) -> list[int]:
    """Returns the hinges that bend a leg: most of them are parallel, as hip, knee and ankle are."""
    axes = {j: robot.data.xaxis[j] for j in leg}
    level = [j for j in axes if abs(axes[j][2]) < 0.5]
    groups = [[k for k in axes if abs(axes[j] @ axes[k]) > 0.9] for j in level]
    return max(groups, key=len, default=[])


def _bend(robot: _Robot, original: Array) -> None:
    """Bends legs that are straight, or whose joints were beyond their ranges in the model's pose.

    Each foot comes to below where it was there, nearer to the trunk and as level, by damped
    Gauss-Newton steps over the joints of its leg alone. A leg that does not reach it stays.
    """
    model, data = robot.model, robot.data
    inside = data.qpos.copy()
    data.qpos[:] = original
    mujoco.mj_kinematics(model, data)
    frames = [
        (data.geom_xpos[f].copy(), data.geom_xmat[f].reshape(3, 3).copy()) for f in robot.feet
    ]
    data.qpos[:] = inside
    for foot, hinges, (wanted, level) in zip(robot.feet, _legs(robot), frames, strict=True):
        mujoco.mj_kinematics(model, data)
        leg = _bending(robot, hinges)
        points = [*data.xanchor[leg], *([] if len(leg) > 2 else [data.geom_xpos[foot]])]
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum() if len(leg) > 1 else 0.0
        places, dofs = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]
        low, high = np.where(
            model.jnt_limited[hinges, None], model.jnt_range[hinges], [-3.0, 3.0]
        ).T
        moved, before = inside[places] != original[places], data.qpos[places].copy()
        is_straight = length and np.linalg.norm(points[-1] - points[0]) > 0.97 * length
        if not (length and (is_straight or moved.any())):
            continue
        wanted[2] += (0.25 if len(robot.feet) > 2 else 0.07) * length
        # A straight knee bends either way; it begins on the side where its range is larger.
        way = 0.3 * np.sign(low + high - 2 * before)
        data.qpos[places] += np.where(np.isin(hinges, leg[1:2]) & ~moved, way, 0.0)
        weight = 0.3 * length * (len(leg) > 2)  # only an ankle keeps a foot level
        jacobian, turning = np.zeros((2, 3, model.nv))
        error = np.zeros(6)
        for _ in range(100):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacGeom(model, data, jacobian, turning, foot)
            turn = 0.5 * np.cross(data.geom_xmat[foot].reshape(3, 3).T, level.T).sum(axis=0)
            error = np.r_[wanted - data.geom_xpos[foot], weight * turn]
            rows = np.concatenate([jacobian, weight * turning])[:, dofs]
            square = rows.T @ rows + 1e-3 * length**2 * np.eye(len(dofs))
            step = np.linalg.solve(square, rows.T @ error)
            data.qpos[places] = np.clip(data.qpos[places] + step, low, high)
        if np.abs(error[:3]).max() > 0.05 * length:
            data.qpos[places] = before
    mujoco.mj_kinematics(model, data)


def _turn(robot: _Robot) -> None:
    """Sets the direction in which a robot goes: that of a swimmer's head, or across its sides."""
    model, data = robot.model, robot.data
    bodies = np.flatnonzero(robot.in_tree(np.arange(model.nbody)))
    places = data.xpos[bodies] - data.xpos[robot.root]
    frame = data.xmat[robot.root].reshape(3, 3)
    if robot.kind == "swimmer":
        behind = data.subtree_com[robot.root] - data.xipos[robot.root]
        if np.abs(behind[:2]).max() > 1e-3:
            axis = int(np.abs(behind[:2]).argmax())
            robot.forward = ("xy"[axis], -float(np.sign(behind[axis])))
    elif robot.is_free:
        local = places @ frame  # in the root's frame, as its velocities are
        images = [local * [-1.0, 1.0, 1.0], local * [1.0, -1.0, 1.0]]
        gaps = (np.abs(image[:, None] - local).sum(axis=2) for image in images)
        unlike = [each.min(axis=1).sum() for each in gaps]
        if unlike[0] < 0.1 * unlike[1]:
            robot.forward = ("y", 1.0)


def _set_goal(robot: _Robot) -> None:
    """Sets the positions that a robot which stays in its place shall come to.

    A pendulum starts where it hangs lowest and shall stand highest: hinges are tried in turn, in
    steps of an eighth of a turn. Another one shall move its joints by up to half a radian.
    """
    model, data = robot.model, robot.data
    robot.goal = np.array(data.qpos)
    if robot.base:
        return
    hinges = [j for j in robot.joints if model.jnt_type[j] == _HINGE]
    if robot.kind != "pendulum":
        for j in robot.joints:
            place, (low, high) = model.jnt_qposadr[j], model.jnt_range[j]
            way, at = 0.5 if j in hinges else 0.1, data.qpos[place]
            if model.jnt_limited[j]:  # towards the middle, or away from it
                inwards = (low + high) / 2 - at
                away = min(way, (high - low) / 4)
                way = np.clip(inwards, -way, way) if abs(inwards) > 0.05 else away
            robot.goal[place] = at + way * (model.jnt_dofadr[j] in robot.driven)
        return
    turning = [j for j in hinges if not model.jnt_limited[j] or np.ptp(model.jnt_range[j]) > 6.0]
    highest, lowest = (_extreme(robot, turning, sign) for sign in (1.0, -1.0))
    robot.goal = highest
    if np.allclose(highest, lowest):  # as of a pole that its limits hold up
        hanging = [j for j in robot.joints if _hangs(robot, j)]
        lowest[model.jnt_qposadr[hanging]] += 0.1
    data.qpos[:], robot.key = lowest, None
    mujoco.mj_forward(model, data)
    places = {j: model.jnt_qposadr[j] for j in robot.joints}
    moved = {j: lowest[i] for j, i in places.items() if abs(lowest[i] - model.qpos0[i]) > 1e-6}
    robot.start = {model.joint(j).name: round(float(angle), 4) for j, angle in moved.items()}


def _extreme(robot: _Robot, joints: list[int], sign: float) -> Array:
    """Returns the positions at which ± the energy of a pendulum is greatest."""
    model, data = robot.model, robot.data
    best = np.array(data.qpos)
    for j in 2 * joints:
        energies, place = [], model.jnt_qposadr[j]
        angles = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
        for angle in angles:
            data.qpos[:] = best
            data.qpos[place] = angle
            mujoco.mj_forward(model, data)
            mujoco.mj_energyPos(model, data)
            energies.append(round(sign * data.energy[0], 9))
        best[place] = angles[int(np.argmax(energies))]
    return best


def _described(robot: _Robot) -> str:
    """Returns what the robot was taken for."""
    base = "free" if robot.is_free else "sliding" if robot.base else "fixed"
    mass = robot.model.body_subtreemass[robot.root]
    of = f"({mass:.3g} kg, a {base} base, {robot.model.nu} actuators)"
    return {
        "swimmer": f"A swimmer {of}: it shall go along {robot.forward[0]}.",
        "vehicle": f"No feet were found {of}: it shall go forwards, whatever it is.",
        "pendulum": f"An underactuated pendulum {of}: it hangs, and shall stand upright.",
        "arm": f"An arm or a hand {of}: it shall reach a pose, or what is called target.",
        "legs": f"Legs, {len(robot.feet)} {of}: it shall go as it is commanded.",
    }[robot.kind] + " If it is not that, change start and cost."


def _changes(robot: _Robot, step: float, dropped: list[str]) -> list[str]:
    model, option = robot.model, robot.model.opt
    fast = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    wanted = (
        ("timestep", f"{step:g}", option.timestep == step),
        ("integrator", "implicitfast", option.integrator == fast),
        ("solver", "Newton", option.solver == mujoco.mjtSolver.mjSOL_NEWTON),
        ("iterations", "100", option.iterations >= 50),
        ("ls_iterations", "50", option.ls_iterations >= 20),
        ("tolerance", "1.0e-10", option.tolerance <= 1e-10),
    )
    lines = [f"  drop: {_flow(dropped)}         # what their files, which are not there, only show"]
    lines = lines if dropped else []
    if options := [f"{name}: {value}" for name, value, has in wanted if not has]:
        lines += ["  # A stable integration, and a solver of constraints for exact derivatives:"]
        lines += [f"  option: {{{', '.join(options)}}}"]
    if _touching(model).any() and not option.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        lines += [
            "  geoms:                                 # soft contact can be differentiated",
            '    "*": {solref: [0.04, 1], solimp: [0, 0.95, 0.02, 0.5, 2]}',
        ]
    if (model.jnt_limited.astype(bool) & (model.jnt_solimp[:, 0] > 0.0)).any():
        lines += [
            "  joints:                                # so can limits whose force begins softly",
            '    "*": {solref_limit: [0.04, 1], solimp_limit: [0, 0.95, 0.1, 0.5, 2]}',
        ]
    has_ground = (model.body_weldid[model.geom_bodyid] == 0).any()
    if robot.base and not has_ground and robot.gravity and robot.kind != "swimmer":
        lines.append("  floor: true                            # the model has none")
    if not model.nu:
        what = "servos [N·m/rad, N·m·s/rad, N·m]" if robot.feet else "motors [N·m]"
        lines.append(f"  actuators:                             # {what}; the model has none")
        groups: dict[float, list[str]] = {}
        for j in robot.joints:
            groups.setdefault(_strength(robot, j), []).append(model.joint(j).name)
        for limit, names in groups.items():
            motor: dict[str, Any] = {"joint": names if len(names) > 1 else names[0]}
            motor |= {"stiffness": 1.5 * limit, "damping": limit / 40} if robot.feet else {}
            key = f"up_to_{limit:g}" if len(names) > 1 else names[0]
            lines.append(f"    {_flow(key)}: {_flow(motor | {'limit': limit})}")
    heading = "changes:                    # made in memory, the model's file stays"
    return [heading, *lines] if lines else []


def _strength(robot: _Robot, joint: int) -> float:
    """Returns a limit for a joint's motor [N·m]: what the model allows, or what its load asks."""
    model, data = robot.model, robot.data
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    body, is_leg = int(model.jnt_bodyid[joint]), any(joint in leg for leg in _legs(robot))
    far = float(np.linalg.norm(data.subtree_com[body] - data.xanchor[joint]))
    carried = 0.5 * model.body_subtreemass[robot.root] * robot.leg
    load = max(3 * model.body_subtreemass[body] * far, carried if is_leg else 0.0)
    return float(f"{(robot.gravity or 9.81) * load:.2g}")


def _places(robot: _Robot) -> list[str]:
    """Returns the cyclic positions, in which nothing differs, but a height."""
    names = [deviation_names(robot.model)[i] for i in cyclic_positions(robot.model)]
    joint = robot.model.joint(robot.base[0]).name if robot.base else ""
    # A height in which nothing differs in the model matters once there is a floor.
    return [name for name in names if not (robot.height and name == f"{joint}/z")]


def _start(robot: _Robot) -> list[str]:
    std: dict[str, Any] = {"position": 0.01, "velocity": 0.1}
    if places := _places(robot):
        std["overrides"] = dict.fromkeys(places, 0.0)
    lines = [f"  std: {_flow(std)}"]
    if robot.start:
        words = [f"{_flow(name)}: {value}" for name, value in robot.start.items()]
        lines.insert(0, f"  positions: {{{', '.join(words)}}}")
    if robot.key is not None:
        lines.insert(0, f"  keyframe: {_flow(robot.model.key(robot.key).name) or robot.key}")
    why = "hanging" if robot.kind == "pendulum" else "on the ground" if robot.height else ""
    why += ", legs a little bent" if robot.feet else ""
    return [f"start:{' ' * 22}# {why}" if robot.start and why else "start:", *lines]


def _signals(robot: _Robot) -> list[str]:
    """Returns what a robot with legs is told: commands, the clock of its gait, and its mirror."""
    if not robot.feet:
        return []
    many = len(robot.feet) > 2
    fast = float(f"{(0.4 if many else 0.22) * (robot.gravity * robot.leg) ** 0.5:.1g}")
    rate = (0.6 if many else 0.36) * (robot.gravity / robot.leg) ** 0.5
    told = {"forward": ("linear/x", [-fast / 2, fast], "m/s")}
    if robot.is_free:
        if robot.forward[0] == "x":
            told["sideways"] = ("linear/y", [-0.4 * fast, 0.4 * fast], "m/s")
        told["turn"] = ("angular/z", [-0.8, 0.8], "rad/s")
    lines = ["# What it is told as it runs: forward, left and about the vertical, as in REP-103."]
    lines.append("commands:")
    for name, (source, ends, unit) in told.items():
        command = {"from": f"cmd_vel/{source}", "range": ends}
        lines.append(f"  {name}: {_flow(command)[:-1]}, unit: {unit}}}")
    return [*lines, f"clock: {{frequency: {rate:.2g}}}       # of the gait [Hz]", *_mirror(robot)]


def _mirror(robot: _Robot) -> list[str]:
    """Returns the exchange of left and right, if places and axes of joints tell it, and names."""
    model, data = robot.model, robot.data
    if not robot.is_free or len(robot.feet) < 2 or robot.forward[0] != "x":
        return []
    frame = data.xmat[robot.root].reshape(3, 3)
    joints = robot.joints
    anchors = {j: (data.xanchor[j] - data.xpos[robot.root]) @ frame for j in joints}
    axes = {j: data.xaxis[j] @ frame for j in joints}
    motors = {int(model.actuator_trnid[i, 0]): model.actuator(i).name for i in range(model.nu)}
    swaps, flips, pairs = set[tuple[str, str]](), list[str](), dict[str, str]()
    for j in joints:
        image = axes[j] * ([-1, 1, -1] if model.jnt_type[j] == _HINGE else [1, -1, 1])
        near = [k for k in joints if np.abs(anchors[j] * [1, -1, 1] - anchors[k]).max() < 0.01]
        near = [k for k in near if abs(image @ axes[k]) > 0.99]
        if len(near) != 1:
            return []
        for names in ({k: model.joint(k).name for k in joints}, motors):
            one, other = names.get(j, ""), names.get(near[0], "")
            pairs[one] = other
            parts = zip(*(re.split(r"([^A-Za-z]+)", n) for n in (one, other)), strict=False)
            swaps |= {(a, b) for a, b in parts if "" < a < b}
            flips += [one] if one and one not in flips and image @ axes[near[0]] < 0 else []
    own = {_new(robot, name): _new(robot, name) for name in ("up", "turning")}
    if any(exchanged(a, sorted(swaps)) != b for a, b in (pairs | own).items()):
        return []
    up, turning = own
    flips += [f"{up}/y", f"{turning}/[xz]", "command/sideways", "command/turn", "clock/*"]
    swapped = [list(pair) for pair in sorted(swaps)]
    return ["mirror:                     # left and right"] + [
        f"  {key}: {_flow(value)}" for key, value in (("swap", swapped), ("flip", flips))
    ]


def _new(robot: _Robot, name: str) -> str:
    """Returns the name of a new sensor, which the model does not have yet."""
    taken = {robot.model.sensor(i).name for i in range(robot.model.nsensor)}
    return f"root_{name}" if name in taken else name


def _up(robot: _Robot) -> Array:
    """Returns the vertical in the root's frame, shape (3,)."""
    return np.array(robot.data.xmat[robot.root].reshape(3, 3)[2])


def _leans(robot: _Robot) -> list[int]:
    """Returns the numbers of the vertical that change when the robot leans, such as x and y."""
    if not robot.base or not robot.gravity or (robot.kind == "swimmer" and not robot.is_free):
        return []
    axes = np.array(
        [robot.model.jnt_axis[j] for j in robot.base if robot.model.jnt_type[j] == _HINGE]
    )
    axes = np.eye(3) if robot.is_free else axes.reshape(-1, 3)
    turning = np.abs(np.cross(axes, _up(robot))).max(axis=0, initial=0.0)
    return [int(i) for i in np.flatnonzero(turning > 1e-6)]


def _balls(robot: _Robot) -> dict[str, list[float]]:
    """Returns the ball joints, with the quaternion of each at the start."""
    model = robot.model
    balls = [j for j in range(model.njnt) if model.jnt_type[j] == _BALL]
    places = {model.joint(j).name: robot.data.qpos[model.jnt_qposadr[j] :][:4] for j in balls}
    return {name: [round(float(v), 4) for v in values] for name, values in places.items()}


def _target(robot: _Robot) -> tuple[str, str, Array] | None:
    """Returns what a model calls its target: the kind of thing, its name, and its place."""
    model, data = robot.model, robot.data
    of_kinds = {"geom": model.geom_bodyid, "site": model.site_bodyid, "body": range(model.nbody)}
    for kind, bodies in of_kinds.items():
        for i, body in enumerate(bodies):
            thing = getattr(data, kind)(i)
            if "target" in thing.name and (kind == "site" or not robot.in_tree(body)):
                return "xbody" if kind == "body" else kind, thing.name, np.array(thing.xpos)
    return None


def _object(robot: _Robot) -> int | None:
    """Returns the first joint of another tree, which the robot may move."""
    model = robot.model
    joints = (j for j in range(model.njnt) if not robot.in_tree(model.jnt_bodyid[j]))
    named = (j for j in joints if "target" not in model.body(model.jnt_bodyid[j]).name)
    return next((j for j in named if model.jnt_dofadr[j] not in robot.driven), None)


def _reached(robot: _Robot) -> dict[str, Any] | None:
    """Returns the sensor of how far something is from the model's target, if it shall get there.

    That is an object beside an arm, or else its tip; and a swimmer, where the target is near.
    """
    model, target, thing = robot.model, _target(robot), _object(robot)
    own = np.flatnonzero(robot.in_tree(model.geom_bodyid))
    if target is None or robot.kind not in ("arm", "swimmer") or not own.size:
        return None
    goal = {"relative_to": {target[0]: target[1]}}
    if robot.kind == "swimmer":
        size = np.ptp(robot.data.geom_xpos[own], axis=0).max() + model.geom_rbound[own].min()
        is_near = np.linalg.norm(target[2] - robot.data.xpos[robot.root]) < _NEAR * size
        return {"type": "framepos", "xbody": robot.name} | goal if is_near else None
    if thing is None:
        return {"type": "framepos", "geom": model.geom(own[-1]).name} | goal
    is_turned, body = model.jnt_type[thing] == _HINGE, model.body(model.jnt_bodyid[thing]).name
    return None if is_turned else {"type": "framepos", "xbody": body} | goal


def _ways(robot: _Robot) -> list[str]:
    """Returns the axes along which anything that joints carry can move, as all but y in a plane."""
    model, data = robot.model, mujoco.MjData(robot.model)
    rng, places = np.random.default_rng(0), []
    for _ in range(3):
        mujoco.mj_integratePos(model, data.qpos, rng.standard_normal(model.nv), 0.3)
        mujoco.mj_kinematics(model, data)
        places.append(data.geom_xpos[model.body_weldid[model.geom_bodyid] > 0].copy())
    return ["xyz"[i] for i in np.flatnonzero(np.ptp(places, axis=0).max(axis=0) > 1e-6)]


def _sensors(robot: _Robot) -> list[str]:
    new: dict[str, Any] = {n + "_turn": {"type": "ballquat", "joint": n} for n in _balls(robot)}
    frame, height = {"xbody": robot.name}, {"type": "framepos", "xbody": robot.name}
    if robot.feet and robot.is_free:  # in its own frame
        new |= {"velocity": {"type": "velocimeter"} | frame, "turning": {"type": "gyro"} | frame}
    elif robot.base:  # of the centre of mass
        new["velocity"] = {"type": "subtreelinvel", "body": robot.name}
    new |= {"height": height} if robot.height else {}
    if _leans(robot):
        new["up"] = {"type": "framezaxis", "xbody": "world", "relative_to": frame}
    for i, foot in enumerate(robot.feet):
        new[f"foot_{i + 1}"] = {"type": "framepos", "geom": robot.model.geom(foot).name}
    if goal := _reached(robot):
        new["to_target"] = goal
    lines = [f"  {_flow(_new(robot, name))}: {_flow(sensor)}" for name, sensor in new.items()]
    if _leans(robot):
        lines.insert(0, "  # up is the vertical in the robot's own frame.")
    return ["sensors:                    # added to the model's own", *lines] if lines else []


def _cost(robot: _Robot) -> list[str]:
    model, data, terms = robot.model, robot.data, list[dict[str, Any]]()
    axis, sign = robot.forward
    velocity, height, up, turning, to_target = (
        {"sensor": _new(robot, name)}
        for name in ("velocity", "height", "up", "turning", "to_target")
    )
    if robot.feet:
        wanted: dict[str, Any] = {"index": axis, "target": {"command": "forward"}}
        if robot.is_free and axis == "x":
            both = [{"command": "forward"}, {"command": "sideways"}]
            wanted = {"index": ["x", "y"], "target": both}
        terms.append(velocity | wanted | {"weight": 8.0, "norm": "smooth_abs", "width": 0.2})
        if robot.is_free:
            terms.append(turning | {"index": "z", "target": {"command": "turn"}, "weight": 5.0})
    elif robot.base and _reached(robot) is None:
        own = data.geom_xpos[robot.in_tree(model.geom_bodyid)]
        size = (
            float(f"{np.ptp(own, axis=0).max(initial=0.0):.1g}") or 0.1
        )  # its length, in a second
        speed = 0.5 * size if robot.kind == "swimmer" else 1.0
        terms.append(velocity | {"index": axis, "target": sign * speed, "weight": speed**-2})
    if robot.height:
        weight = 40.0 / robot.leg**2 if robot.feet else 10.0
        terms.append(height | {"index": "z", "target": robot.height, "weight": weight})
    if leans := _leans(robot):
        weight, target = 20.0 if robot.feet else 5.0, [_up(robot)[i] for i in leans]
        index = ["xyz"[i] for i in leans]
        terms.append(up | {"index": index, "target": target, "weight": weight})
    for i, foot in enumerate(robot.feet):  # they swing in turn, at the clock's rhythm
        rest = data.geom_xpos[foot, 2] - _ground(model, data)  # its height while it is down
        swing = {"swing": 0.12 * robot.leg, "phase": 0.5 * (i % 2), "rest": rest}
        terms.append({"sensor": f"foot_{i + 1}", "index": "z", "target": swing})
        terms[-1]["weight"] = 120.0 / robot.leg**2
    if _reached(robot):
        terms.append(to_target | {"index": _ways(robot), "weight": 20.0})
    terms += [] if robot.base else _pose_cost(robot)
    lines = ["cost:                       # what is wanted, and what it may cost"]
    return lines + [f"  - {_flow(term)}" for term in [*terms, *_control_cost(robot)]]


def _turning(robot: _Robot) -> list[int]:
    """Returns the hinges of a pendulum that turn without end, so that sine and cosine count."""
    model, is_one = robot.model, robot.kind == "pendulum"
    hinges = [j for j in robot.joints if model.jnt_type[j] == _HINGE and is_one]
    return [j for j in hinges if not model.jnt_limited[j]]


def _pose_cost(robot: _Robot) -> list[dict[str, Any]]:
    """Returns the cost of a robot that stays in its place: its goal, and rest there.

    What it shall do to a thing beside it is not known: as a guess, it turns it.
    """
    model, terms, thing = robot.model, list[dict[str, Any]](), _object(robot)
    has_target = _reached(robot) is not None
    is_turned = thing is not None and model.jnt_type[thing] != _SLIDE and not has_target
    for j in robot.joints:
        name, goal = model.joint(j).name, robot.goal[model.jnt_qposadr[j]]
        if j in _turning(robot):  # what a motor drives may turn on the way
            weight = 0.1 if model.jnt_dofadr[j] in robot.driven else 1.0
            for wave, to in (("cos", np.cos(goal)), ("sin", np.sin(goal))):
                term = {"sensor": f"{name}/{wave}", "target": round(float(to), 3)}
                terms.append(term | {"weight": weight})
        elif not (has_target or is_turned):
            weight = 0.1 if robot.kind == "pendulum" else 1.0
            terms.append({"sensor": f"{name}/position", "target": goal, "weight": weight})
        terms.append({"sensor": f"{name}/velocity", "weight": 0.01})
    for name, turn in _balls(robot).items():
        terms.append({"sensor": _new(robot, name + "_turn"), "target": turn})
        terms += [{"sensor": rate, "weight": 0.1} for rate in _rates(name)]
    if is_turned:
        rate = "velocity" if model.jnt_type[thing] == _HINGE else "wz"
        terms.append({"sensor": f"{model.joint(thing).name}/{rate}", "target": 3.0})
    return terms


def _control_cost(robot: _Robot) -> list[dict[str, Any]]:
    """Returns the cost of controls: each weighs the same at its own limit, of a servo its force."""
    model = robot.model
    strong = 3.0 if robot.feet else 0.5  # what a control at its limit costs in each step
    if not model.nu:
        stiff = {"pose": "start", "weight": strong} if robot.feet else {"weight": strong / 400}
        return [{"control": "all"} | stiff]
    controls, groups = controls_of(model), dict[tuple[bool, str], list[str]]()
    for i, (kind, high) in enumerate(zip(controls.kinds, controls.limits[1], strict=True)):
        is_servo = kind is ControlKind.POSITION
        limit = high if np.isfinite(high) and high > 0 else 10.0
        if is_servo:  # the target from which on its force is greatest [rad]
            force = controls.servo_forces[i]
            limit = min(force / controls.stiffness[i], 1.0) if force < 1e6 else _UNKNOWN_REACH
        weight = f"{strong / limit**2:.2g}"
        groups.setdefault((is_servo, weight), []).append(model.actuator(i).name)
    return [
        {"control": "all" if len(groups) == 1 else names}
        | ({"pose": "start"} if is_servo else {})
        | {"weight": float(weight)}
        for (is_servo, weight), names in groups.items()
    ]


def _observed(robot: _Robot) -> list[str]:
    model, entries = robot.model, list[Any]()
    turning = [model.joint(j).name for j in _turning(robot)]
    cyclic = {name.rpartition("/")[0] for name in _places(robot)}
    out = [name for name in joint_names(model) if name in cyclic or name in turning]
    if len(out) < len(joint_names(model)):
        entries.append({"joint_positions": {"except": out}} if out else "joint_positions")
    entries += ["joint_velocities"] if joint_names(model) else []
    entries += [{"joint": name, "as": "sin_cos"} for name in turning]
    entries += [_new(robot, "up")] if robot.is_free and _leans(robot) else []
    if robot.is_free and robot.feet:
        entries.append(_new(robot, "turning"))
    elif robot.is_free:
        joint = model.joint(robot.base[0]).name
        entries += [*(f"{joint}/{rate}" for rate in ("z", "vx", "vy", "vz")), *_rates(joint)]
    for name in _balls(robot):
        entries += [_new(robot, name + "_turn"), *_rates(name)]
    entries += [_new(robot, "to_target")] if _reached(robot) else []
    lagging = (model.actuator(int(i)).name for i in np.flatnonzero(model.actuator_actnum == 1))
    entries += [f"{name}/activation" for name in lagging]
    entries += ["commands", "clock"] if robot.feet else []
    return ["observe:                    # what the policy reads", f"  {_flow(entries)}"]


def _rates(joint: str) -> list[str]:
    return [f"{joint}/{rate}" for rate in ("wx", "wy", "wz")]


def _begin(robot: _Robot) -> str:
    model = robot.model
    high = controls_of(model).limits[1] if model.nu else np.full(1, np.inf)
    kinds = set(controls_of(model).kinds) if model.nu else set()
    if len(robot.feet) == 2 and robot.is_free:
        return "begin: {law: path}          # the start, as if it held; DDP makes it feasible"
    if robot.height or (robot.kind == "arm" and kinds == {ControlKind.POSITION}):
        return "begin: {law: pd}            # the first motion holds the start"
    if robot.kind == "pendulum":
        return "begin: {law: best}          # of several first motions, each improved by DDP"
    std = [0.2 * h if np.isfinite(h) and h > 0 else 1.0 for h in high.tolist()]
    noise = {"law": "noise", "std": std if len(set(std)) > 1 else std[0], "time_constant": 0.3}
    return f"begin: {_flow(noise)}   # smooth noise"
