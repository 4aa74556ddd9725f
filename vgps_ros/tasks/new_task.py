# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a first task file for a robot, with comments that say what to change.

What the robot is for follows from its tree of bodies, its base, its mass and its actuators; names
count only where one says `target`. What it does not know, the file says. Here are the facts about
the robot; the lines that they pick and fill stand in `new_task.template`.
"""

import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.controls import ControlKind, Mask
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import cyclic_positions, deviation_names, joint_names
from vgps_ros.tasks.builder import exchanged
from vgps_ros.tasks.schema import MOST_CONTACTS

_TEMPLATE = Path(__file__).with_name("new_task.template")
_UNKNOWN_REACH = 0.8  # of a servo whose force has no limit: the target at which it is strong [rad]
_DENSE = 100.0  # density from which on a medium is a liquid [kg/m³]
_NEAR = 2.0  # body lengths within which a swimmer is sent to a target
_FREE, _BALL, _SLIDE, _HINGE = range(4)  # as in mjtJoint
_SENSORS = ("velocity", "turning", "height", "up", "to_target")  # whose names may be taken
_AT_JOINT = mujoco.mjtTrn.mjTRN_JOINT
_CHANGES = ("drop", "remove_bodies", "locks", "options", "contact", "limits", "floor", "motors")


@dataclass
class _Robot:
    """Facts about a model from which its first task file is written."""

    model: mujoco.MjModel
    data: mujoco.MjData  # at the start
    root: int  # the body that carries all others
    trees: list[int]  # of bodies: one, or of a robot that stays in its place all that it drives
    base: list[int]  # the joints that carry the whole robot along
    driven: set[int]  # the degrees of freedom that the actuators move
    gravity: float  # [m/s²]
    key: int | None = None  # the keyframe from which it starts
    kind: str = "arm"
    feet: list[int] = field(default_factory=list)  # a geom of each, by the angle around the robot
    height: float = 0.0  # of the root above the ground [m]; 0 if it cannot rise or fall
    forward: tuple[str, float] = ("x", 1.0)  # the axis along which it goes, and in which direction
    goal: Array = field(default_factory=lambda: np.empty(0))  # qpos
    strengths: dict[str, float] | None = None  # of joints whose actuators servos replace [N·m]

    @property
    def leg(self) -> float:
        """The height of its hips [m], by which speeds, steps and weights scale."""
        first = (_bending(self, leg)[:1] for leg in _legs(self))
        hips = [self.data.xanchor[j][2] for joints in first for j in joints]
        return max([h - _ground(self) for h in hips], default=self.height)

    @property
    def name(self) -> str:
        """The root's name."""
        return str(self.model.body(self.root).name)

    @property
    def mass(self) -> float:
        """Its mass [kg]."""
        return float(self.model.body_mass[self.in_tree(np.arange(self.model.nbody))].sum())

    @property
    def is_free(self) -> bool:
        """Whether it has a free joint."""
        return any(self.model.jnt_type[j] == _FREE for j in self.base)

    @property
    def motors(self) -> dict[int, int]:
        """The joint of each actuator that drives one by itself."""
        own = np.flatnonzero(self.model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
        return {int(i): int(self.model.actuator_trnid[i, 0]) for i in own}

    @property
    def is_biped(self) -> bool:
        """Whether it has two feet, nearer to each other than its hips are to the ground.

        It may fall over them; one leg before the other, as a cheetah's, is no such stance.
        """
        places = self.data.geom_xpos[self.feet]
        return len(places) == 2 and bool(np.linalg.norm(places[0] - places[1]) < self.leg)

    @property
    def hops(self) -> bool:
        """Whether it has one leg."""
        return len(self.feet) == 1

    @property
    def joints(self) -> list[int]:
        """The hinges and slides of its tree that are not its base."""
        kinds, bodies = self.model.jnt_type, self.model.jnt_bodyid
        own = np.flatnonzero((kinds >= _SLIDE) & self.in_tree(bodies))
        return [int(j) for j in own if j not in self.base]

    @property
    def hinges(self) -> list[int]:
        """The hinges among them."""
        return [j for j in self.joints if self.model.jnt_type[j] == _HINGE]

    @property
    def frame(self) -> Array:
        """The root's axes as columns, shape (3, 3)."""
        return np.array(self.data.xmat[self.root].reshape(3, 3))

    def in_tree(self, bodies: Any) -> Mask:
        """Returns which of the bodies are the robot's."""
        return np.isin(self.model.body_treeid[bodies], self.trees)

    def chain(self, body: int) -> list[int]:
        """Returns the bodies from this one up, without the root of a robot that travels."""
        found = list[int]()
        while body not in (0, self.root if self.base else 0):
            found.append(body)
            body = int(self.model.body_parentid[body])
        return found

    def reset(self, key: int | None) -> "_Robot":
        """Starts from a keyframe, or from the model's own start."""
        self.key = key
        if key is None:
            mujoco.mj_resetData(self.model, self.data)
        else:
            mujoco.mj_resetDataKeyframe(self.model, self.data, key)
        mujoco.mj_forward(self.model, self.data)
        return self

    def moved(self) -> dict[str, Any]:
        """Returns the positions in which the data differ from the keyframe, or the model's own."""
        model, found = self.model, dict[str, Any]()
        before = model.qpos0 if self.key is None else model.key_qpos[self.key]
        for j, first in enumerate(model.jnt_qposadr):
            place = slice(first, first + {_FREE: 7, _BALL: 4}.get(int(model.jnt_type[j]), 1))
            if not np.allclose(self.data.qpos[place], before[place], atol=1e-4):
                values = self.data.qpos[place].round(4).tolist()
                found[model.joint(j).name] = values if len(values) > 1 else values[0]
        return found


def things_beside_legs(model: mujoco.MjModel) -> list[str]:
    """Returns the bodies that move beside a robot with legs, and that are not called a target.

    Raises:
        InvalidInputError: no actuator drives a joint, and no joint could have one.
    """
    robot = _robot(model)
    trees = {int(i) for i in model.dof_treeid if robot.feet} - {*robot.trees}
    names = [model.body(np.flatnonzero(model.body_treeid == i)[0]).name for i in sorted(trees)]
    return [name for name in names if "target" not in name]


def first_task_file(
    reference: str,
    model: mujoco.MjModel,
    schema: str,
    changes: dict[str, Any],
    former: mujoco.MjModel,
) -> str:
    """Returns the text of a task file for a model, all of whose joints and actuators have names.

    The file names the model by the reference, and a JSON schema by its path, for editors; `changes`
    is what has been dropped, locked and removed of the model already, as a task's `changes` have
    it, and `former` the model with its own actuators, as strong as which servos in their place are.

    Raises:
        InvalidInputError: no actuator drives a joint, and no joint could have one.
    """
    robot = _robot(model)
    if former.nu > model.nu:
        largest = controls_of(former).largest
        pairs = zip(former.actuator_trntype, former.actuator_trnid[:, 0], largest, strict=True)
        at_joint = [(former.joint(j).name, force) for kind, j, force in pairs if kind == _AT_JOINT]
        robot.strengths = {name: float(force) for name, force in at_joint if np.isfinite(force)}
    named = ("drop", "remove_bodies", "remove_actuators")
    facts: dict[str, Any] = dict.fromkeys(named) | changes
    facts |= _facts(robot) | {"schema": schema, "model": reference}
    locks = changes.get("joints", {}).items()
    facts["locks"] = [f"{_flow(name)}: {_flow(values)}" for name, values in locks]
    facts["jointed"] = facts["locks"] or facts["limits"]
    facts["changes"] = any(facts[name] for name in _CHANGES)
    said = {key: value if isinstance(value, str) else _flow(value) for key, value in facts.items()}
    lines = list[str]()
    for line in _TEMPLATE.read_text().splitlines():
        conditions, bar, text = line.partition("| ")
        met = (bool(facts.get(c.lstrip("-"))) != c.startswith("-") for c in conditions.split())
        if bar and all(met):
            text, _, each = text.partition("@")
            filled = Template(text).substitute(said)
            lines += [filled + entry for entry in facts[each]] if each else [filled]
    return "\n".join(lines) + "\n"


def _whole(duration: float, period: float) -> float:
    """Returns the multiple of a period that is nearest to a duration [s]."""
    return max(1, round(duration / period)) * period


def _flow(value: Any, digits: int = 3) -> str:
    """Returns a value as YAML has it on one line, with so many digits of a number."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_flow(k)}: {_flow(v, digits)}' for k, v in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(_flow(entry, digits) for entry in value)}]"
    if isinstance(value, str):
        is_plain = re.fullmatch(r"(?!(on|off|yes|no|true|false|null)$)[A-Za-z_][\w/.-]*", value)
        return value if is_plain else json.dumps(value)
    if value is None or isinstance(value, bool | np.bool):
        return str(value).lower()
    number = ".inf" if value == np.inf else f"{float(f'{value + 0.0:.{digits}g}'):g}"
    return re.sub(r"^(-?\d+)e", r"\1.0e", number)


def _robot(model: mujoco.MjModel) -> _Robot:
    """Returns the facts about a model; its kind decides how it starts, and what its goal is."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    driven = {int(i) for i in data.moment_colind[: int(data.moment_rownnz.sum())]}
    single = {int(i) for i in model.jnt_dofadr[model.jnt_type >= _SLIDE]}
    trees = model.dof_treeid[[*(driven or single)]]
    if not (trees >= 0).any():
        raise InvalidInputError(
            "--model: no actuator drives a joint, and there is no hinge or slide that a motor "
            "could drive; name a model of a robot."
        )
    tree = int(np.bincount(trees[trees >= 0]).argmax())
    root = int(np.flatnonzero(model.body_treeid == tree)[0])
    first = [int(j) for j in model.body_jntadr[root] + np.arange(model.body_jntnum[root])]
    base = [j for j in first if model.jnt_dofadr[j] not in driven]
    free = any(model.jnt_type[j] == _FREE for j in base)
    slides = any(model.jnt_type[j] == _SLIDE for j in base) and (model.nu or len(first) > 1)
    base = base if free or slides else []
    flags = model.opt.disableflags
    gravity = 0.0 if flags & mujoco.mjtDisableBit.mjDSBL_GRAVITY else abs(model.opt.gravity[2])
    trees = [tree] if base or not driven else trees[trees >= 0].tolist()
    robot = _Robot(model, data, root, trees, base, driven or single, float(gravity))
    if not model.nu and not robot.joints:
        raise InvalidInputError(
            "--model: nothing but its base moves, and no actuator drives that; name a model with "
            "links and motors. Where a program adds them, save the MJCF that it makes."
        )
    ups = [round(robot.reset(key).frame[2, 2], 1) for key in range(model.nkey)]
    key = int(np.argmax(ups)) if ups else None
    robot.reset(None if key is None or np.allclose(model.key_qpos[key], model.qpos0) else key)
    if base and (model.opt.density > _DENSE or model.opt.viscosity > 1e-3):
        robot.kind = "swimmer"
    elif base:
        robot.kind = "vehicle"
        if robot.gravity and _vertical(robot) is not None:
            _stand(robot)
    elif robot.gravity and any(_hangs(robot, j) for j in robot.joints):
        robot.kind = "pendulum"
    elif _fingers(robot) > 2:
        robot.kind = "hand"
    _turn(robot)
    _set_goal(robot)
    return robot


def _hangs(robot: _Robot, joint: int) -> bool:
    """Returns whether gravity moves a hinge: there is no motor, spring or loop, or it is weak."""
    model = robot.model
    if model.jnt_type[joint] != _HINGE:
        return False
    if model.jnt_dofadr[joint] in robot.driven:
        return _is_weak(robot, joint)
    tied = {int(i) for i in [*model.eq_obj1id, *model.eq_obj2id]} if model.neq else set()
    return not np.any(model.jnt_stiffness[joint]) and joint not in tied


def _is_weak(robot: _Robot, joint: int) -> bool:
    """Returns whether a hinge turns without end, and gravity overcomes its motors on the way.

    Not where the robot has a thing beside it, which it is for.
    """
    model, data = robot.model, robot.data
    motors = [i for i, j in robot.motors.items() if j == joint]
    if model.jnt_limited[joint] or not motors or _object(robot) is not None:
        return False
    start, place, pull = data.qpos.copy(), model.jnt_qposadr[joint], 0.0
    for angle in np.linspace(0.0, 2 * np.pi, 8, endpoint=False):
        data.qpos[place] = angle
        mujoco.mj_forward(model, data)
        pull = max(pull, abs(data.qfrc_bias[model.jnt_dofadr[joint]]))
    data.qpos[:] = start
    mujoco.mj_forward(model, data)
    return bool(pull > controls_of(model).largest[motors].sum())


def _swing_time(robot: _Robot) -> float:
    """Returns the time in which a pendulum swings up and then stands for a while [s].

    Weak motors need several swings: they pull with all their force in the direction in which their
    joints turn, until the energy is that of the goal. Nobody swings up faster.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    weak = [i for i, j in robot.motors.items() if _is_weak(robot, j)]
    if not weak:
        return 4.0
    full, dofs = controls_of(model).limits[1], model.jnt_dofadr[[robot.motors[i] for i in weak]]

    def energy() -> float:
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        return float(data.energy.sum())

    data.qpos[:] = robot.goal
    goal, data.qpos[:] = energy(), robot.data.qpos
    while energy() < goal and data.time < 10.0:
        data.ctrl[weak] = np.where(data.qvel[dofs] >= 0.0, full[weak], -full[weak])
        mujoco.mj_step(model, data)
    return float(np.clip(np.ceil(2.0 * data.time), 8.0, 16.0))


def _fingers(robot: _Robot) -> int:
    """Returns the number of branches of at least two hinges from which nothing branches off."""
    bodies = np.unique(robot.model.jnt_bodyid[robot.joints])
    chains = [robot.chain(int(body)) for body in bodies]
    passed = [body for chain in chains for body in chain]
    ends = [chain for chain in chains if chain and passed.count(chain[0]) == 1]
    all_ends = [body for chain in ends for body in chain]
    hinged = [int(robot.model.jnt_bodyid[j]) for j in robot.hinges]
    own = [[body for body in chain if all_ends.count(body) == 1] for chain in ends]
    return sum(sum(hinged.count(body) for body in chain) > 1 for chain in own)


def _vertical(robot: _Robot) -> int | None:
    """Returns the place in qpos of the base's height."""
    model = robot.model
    for j in robot.base:
        is_free = model.jnt_type[j] == _FREE
        if is_free or (model.jnt_type[j] == _SLIDE and abs(robot.data.xaxis[j][2]) > 0.5):
            return int(model.jnt_qposadr[j] + 2 * is_free)
    return None


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
    if robot.feet:
        _bend(robot, original)
        robot.feet = _feet(robot)
    lowest = float(_bottoms(robot).min(initial=np.inf))
    if np.isfinite(lowest):
        depth = float(np.ceil(1e3 * (_ground(robot) - lowest)) / 1e3)
        hovers = robot.feet and 0.01 < -depth < 2.0 * (data.xpos[robot.root][2] - lowest)
        data.qpos[_vertical(robot)] += depth if depth > 1e-3 or hovers else 0.0
    mujoco.mj_forward(model, data)
    robot.height = float(data.xpos[robot.root][2] - _ground(robot))
    if robot.feet:
        robot.kind = "legs"


def _touching(model: mujoco.MjModel) -> Mask:
    found: Mask = (model.geom_contype | model.geom_conaffinity) != 0
    found[np.concatenate([model.pair_geom1, model.pair_geom2]).astype(int)] = True
    return found


def _ground(robot: _Robot) -> float:
    """Returns the height of the model's level planes, or 0 [m]."""
    return float(robot.data.geom_xpos[_planes(robot), 2].max(initial=0.0))


def _planes(robot: _Robot) -> Mask:
    """Returns which geoms are level planes on which something can stand."""
    is_plane = robot.model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    return _touching(robot.model) & is_plane & (robot.data.geom_xmat[:, 8] > 0.9)


def _bottoms(robot: _Robot) -> Array:
    """Returns the height of each geom's lowest point, inf if it touches nothing, shape (ngeom,).

    A sphere's and a capsule's are exact, others reach as far as their boxes.
    """
    model, rows = robot.model, robot.data.geom_xmat[:, 6:]
    boxes = np.abs(rows * model.geom_aabb[:, 3:]).sum(axis=1)
    boxes -= (rows * model.geom_aabb[:, :3]).sum(axis=1)
    is_capsule = model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
    round_ends = model.geom_size[:, 0] + model.geom_size[:, 1] * np.abs(rows[:, 2]) * is_capsule
    is_round = is_capsule | (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
    bottoms = robot.data.geom_xpos[:, 2] - np.where(is_round, round_ends, boxes)
    return np.where(_touching(model) & robot.in_tree(model.geom_bodyid), bottoms, np.inf)


def _feet(robot: _Robot) -> list[int]:
    """Returns a geom of each foot, by the angle around the robot, the left front one first."""
    model, data = robot.model, robot.data
    bottoms = _bottoms(robot)
    bodies = np.unique(model.geom_bodyid[np.isfinite(bottoms)])
    lowest = float(bottoms.min(initial=np.inf))
    reach = lowest + 0.1 * (data.xpos[robot.root][2] - lowest)
    found = dict[int, int]()
    for body in map(int, np.setdiff1d(bodies, [*model.body_parentid[bodies], robot.root])):
        own = np.flatnonzero((model.geom_bodyid == body) & np.isfinite(bottoms))
        if bottoms[own].min() < reach and not _is_wheel(robot, body, own):
            soles = own[bottoms[own] < bottoms[own].min() + 0.005]
            places = data.geom_xpos[soles]
            nearest = np.abs(places - places.mean(axis=0)).sum(axis=1).argmin()
            found[int(model.body_parentid[body])] = int(soles[nearest])
    for geom in list(found.values()):  # what is above a foot on the same leg is none
        for parent in robot.chain(int(model.geom_bodyid[geom]))[1:]:
            if parent in found and bottoms[found[parent]] > bottoms[geom] + 0.01:
                del found[parent]
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
    model = robot.model
    bodies = [robot.chain(int(model.geom_bodyid[foot])) for foot in robot.feet]
    alone = [[b for b in leg if sum(b in other for other in bodies) == 1] for leg in bodies]
    return [[j for j in robot.hinges if model.jnt_bodyid[j] in leg] for leg in alone]


def _bending(robot: _Robot, leg: list[int]) -> list[int]:
    """Returns the hinges that bend a leg: most of them are parallel, as hip, knee and ankle are."""
    axes = {j: robot.data.xaxis[j] for j in leg}
    level = [j for j in axes if abs(axes[j][2]) < 0.5]
    groups = [[k for k in axes if abs(axes[j] @ axes[k]) > 0.9] for j in level]
    return max(groups, key=len, default=[])


def _bend(robot: _Robot, original: Array) -> None:
    """Bends legs that are straight, or whose joints were beyond their ranges in the model's pose.

    Each foot comes to below where it was there, or at least near it, nearer to the trunk and as
    level, by damped Gauss-Newton steps over the joints of its leg. One that does not stays.
    """
    model, data = robot.model, robot.data
    inside = data.qpos.copy()
    data.qpos[:] = original
    mujoco.mj_kinematics(model, data)
    places, frames = data.geom_xpos.copy(), data.geom_xmat.reshape(-1, 3, 3).copy()
    data.qpos[:] = inside
    middle, spread = places[robot.feet].mean(axis=0), np.ptp(places[robot.feet], axis=0)
    # Pushes to the side are what four legs in a narrow stance do not bear.
    is_narrow = len(robot.feet) > 2 and spread[:2].min() < data.xpos[robot.root][2] - middle[2]
    wider = 0.15 * (spread[:2] == spread[:2].min()) * is_narrow
    for foot, hinges in zip(robot.feet, _legs(robot), strict=True):
        wanted, level = places[foot], frames[foot]
        mujoco.mj_kinematics(model, data)
        leg = _bending(robot, hinges)
        points = [*data.xanchor[leg], *([] if len(leg) > 2 else [data.geom_xpos[foot]])]
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum() if len(leg) > 1 else 0.0
        at, dofs = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]
        low, high = np.where(
            model.jnt_limited[hinges, None], model.jnt_range[hinges], [-3.0, 3.0]
        ).T
        moved, before = inside[at] != original[at], data.qpos[at].copy()
        is_straight = length and np.linalg.norm(points[-1] - points[0]) > 0.97 * length
        if not (length and (is_straight or moved.any())):
            continue
        wanted[2] += (0.36 if len(robot.feet) > 2 else 0.07) * length
        wanted[:2] += wider * np.sign(wanted[:2] - middle[:2]) * length
        # A straight knee bends either way; it begins on the side where its range is larger.
        way = 0.3 * np.sign(low + high - 2 * before)
        bent = before + np.where(np.isin(hinges, leg[1:2]) & ~moved, way, 0.0)
        weight = 0.3 * length * (len(leg) > 2)  # only an ankle keeps a foot level
        jacobian, turning = np.zeros((2, 3, model.nv))
        for aside in (1.0, 0.3):  # how much it counts to be right below
            near = np.array([aside, aside, 1.0])
            data.qpos[at] = bent
            for _ in range(100):
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_jacGeom(model, data, jacobian, turning, foot)
                turn = 0.5 * np.cross(data.geom_xmat[foot].reshape(3, 3).T, level.T).sum(axis=0)
                error = np.r_[near * (wanted - data.geom_xpos[foot]), weight * turn]
                rows = np.concatenate([near[:, None] * jacobian, weight * turning])[:, dofs]
                for _ in range(2):  # again without the joints that it drives against their limits
                    square = rows.T @ rows + 1e-3 * length**2 * np.eye(len(dofs))
                    step = np.linalg.solve(square, rows.T @ error)
                    now = data.qpos[at]
                    rows *= ((now > low) | (step > 0)) & ((now < high) | (step < 0))
                data.qpos[at] = np.clip(now + step, low, high)
            if np.abs(error[:3]).max() < 0.05 * length:
                break
        else:
            data.qpos[at] = before
    mujoco.mj_kinematics(model, data)


def _turn(robot: _Robot) -> None:
    """Sets the direction in which a robot goes: that of a swimmer's head, or across its sides."""
    model, data = robot.model, robot.data
    bodies = np.flatnonzero(robot.in_tree(np.arange(model.nbody)))
    if robot.kind == "swimmer":
        behind = data.subtree_com[robot.root] - data.xipos[robot.root]
        if np.abs(behind[:2]).max() > 1e-3:
            axis = int(np.abs(behind[:2]).argmax())
            robot.forward = ("xy"[axis], -float(np.sign(behind[axis])))
    elif robot.is_free:
        # In the root's frame, as its velocities are:
        local = (data.xpos[bodies] - data.xpos[robot.root]) @ robot.frame
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
    if robot.kind != "pendulum":
        for j in robot.joints:
            place, (low, high) = model.jnt_qposadr[j], model.jnt_range[j]
            at, way = data.qpos[place], 0.5 if model.jnt_type[j] == _HINGE else 0.1
            if model.jnt_limited[j]:  # towards the middle, or away from it
                inwards = (low + high) / 2 - at
                away = min(way, (high - low) / 4)
                way = np.clip(inwards, -way, way) if abs(inwards) > 0.05 else away
            robot.goal[place] = at + way * (model.jnt_dofadr[j] in robot.driven)
        return
    wide = ~model.jnt_limited.astype(bool) | (np.ptp(model.jnt_range, axis=1) > 6.0)
    turning = [j for j in robot.hinges if wide[j]]
    robot.goal, lowest = (_extreme(robot, turning, sign) for sign in (1.0, -1.0))
    if np.allclose(robot.goal, lowest):  # as of a pole that its limits hold up
        lowest[model.jnt_qposadr[[j for j in robot.joints if _hangs(robot, j)]]] += 0.1
    data.qpos[:], robot.key = lowest, None
    mujoco.mj_forward(model, data)


def _extreme(robot: _Robot, joints: list[int], sign: float) -> Array:
    """Returns the positions at which ± the energy of a pendulum is greatest."""
    model, data = robot.model, robot.data

    def energy(qpos: Array) -> float:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        return round(sign * float(data.energy[0]), 9)

    best = np.array(data.qpos)
    for place in 2 * model.jnt_qposadr[joints].tolist():
        tried = np.tile(best, (8, 1))
        tried[:, place] = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
        best = max(tried, key=energy)
    return best


def _facts(robot: _Robot) -> dict[str, Any]:
    """Returns the facts of which the template speaks; what it asks for and is not here, is not."""
    model, legs = robot.model, bool(robot.feet)
    step = max(0.005, model.opt.timestep) if legs else model.opt.timestep
    period = _whole(0.02 if legs or robot.kind == "pendulum" else 0.01, step)
    swings = _swing_time(robot) if robot.kind == "pendulum" else 0.0
    horizon = _whole(1.0 if legs else swings or 2.0, period)
    times = {
        "step": step,
        "period": period,
        "horizon": horizon,
        "twice": 2 * horizon,
        "lookahead": _whole(0.5, period),
    }
    base = "free" if robot.is_free else "sliding" if robot.base else "fixed"
    std: dict[str, Any] = {"position": 0.01, "velocity": 0.1}
    if same := _places(robot):
        std["overrides"] = dict.fromkeys(same, 0.0)
    moved = robot.moved()
    listed = {
        "joints": [model.joint(i).name for i in range(model.njnt)],
        "actuators": [model.actuator(i).name for i in range(model.nu)],
        "keyframes": [model.key(i).name or str(i) for i in range(model.nkey)],
        "sensors": [model.sensor(i).name for i in range(model.nsensor)],
    }
    return {
        robot.kind: True,
        "robot": f"({robot.mass:.3g} kg, a {base} base, {model.nu} actuators)",
        "count": len(robot.feet) or _fingers(robot),
        **{what: ", ".join(filter(None, names)) or "none" for what, names in listed.items()},
        **{name: f"{time:g}" for name, time in times.items()},
        "travels": bool(robot.base),
        "keyframe": None if robot.key is None else listed["keyframes"][robot.key],
        "moved": _flow(moved, 5) if moved else "",
        "std": std,
        "observed": _observed(robot),
        **{name.upper(): _flow(_new(robot, name)) for name in _SENSORS},
        **_changes(robot, step),
        **_scored(robot),
        **_begin(robot),
        **(_signals(robot) if legs else {}),
    }


def _changes(robot: _Robot, step: float) -> dict[str, Any]:
    """Returns what is changed of the model."""
    model, option = robot.model, robot.model.opt
    wanted = {  # where the model's own will not do
        "timestep": (step, option.timestep == step),
        "integrator": (
            "implicitfast",
            option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
        ),
        "solver": ("Newton", option.solver == mujoco.mjtSolver.mjSOL_NEWTON),
        "iterations": (100, option.iterations >= 50),
        "ls_iterations": (50, option.ls_iterations >= 20),
        "tolerance": (1e-10, option.tolerance <= 1e-10),
    }
    touches = not option.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    has_ground = (model.body_weldid[model.geom_bodyid] == 0).any()
    groups = dict[float, list[str]]()
    for j in [] if model.nu else robot.joints:
        groups.setdefault(_strength(robot, j), []).append(model.joint(j).name)
    motors = []
    for limit, names in groups.items():
        motor: dict[str, Any] = {"joint": names if len(names) > 1 else names[0]}
        if robot.feet or robot.strengths is not None:  # damped as a gear damps
            servo = {"stiffness": 1.5 * limit, "damping": limit / 20, "armature": limit / 1000}
            motor |= servo
        key = f"up_to_{limit:g}" if len(names) > 1 else names[0]
        motors.append(f"{_flow(key)}: {_flow(motor | {'limit': limit})}")
    return {
        "options": {name: value for name, (value, has) in wanted.items() if not has},
        "contact": touches and _touching(model).any(),
        "soft": _flow(_soft(robot), 2),
        "limits": (model.jnt_limited.astype(bool) & (model.jnt_solimp[:, 0] > 0.0)).any(),
        "floor": robot.base and not has_ground and robot.gravity and robot.kind != "swimmer",
        "motors": motors,
        "servos": bool(robot.feet) or robot.strengths is not None,
        "only": _contacts(robot) if touches else None,
    }


def _contacts(robot: _Robot) -> list[list[str]]:
    """Returns the pairs of a ground and a foot, if all have names and nothing else moves."""
    model = robot.model
    if not robot.in_tree(model.dof_bodyid).all():  # a target, which `things_beside_legs` leaves
        return []
    feet = np.isin(model.geom_bodyid, model.geom_bodyid[robot.feet])
    feet &= _bottoms(robot) < _ground(robot) + 0.1 * robot.leg
    grounds = _planes(robot)
    if not grounds.any():
        grounds = (model.body_weldid[model.geom_bodyid] == 0) & _touching(model)
    sides = [[model.geom(i).name for i in np.flatnonzero(these)] for these in (grounds, feet)]
    pairs = [[ground, foot] for ground in sides[0] or ["floor"] for foot in sides[1]]
    return pairs if all(map(all, sides)) and len(pairs) <= MOST_CONTACTS else []


def _signals(robot: _Robot) -> dict[str, Any]:
    """Returns what a robot with legs is told: commands, the clock of its gait, and its mirror."""
    many = len(robot.feet) > 2
    fast = float(f"{(0.4 if many else 0.22) * (robot.gravity * robot.leg) ** 0.5:.1g}")
    rate = (0.6 if many or robot.hops else 0.36) * (robot.gravity / robot.leg) ** 0.5
    two = robot.is_biped
    push = 3.0 if many else 0.3 if robot.hops else 0.25 if two else 1.0  # [m/s]
    return {
        "ahead": [0.0 if robot.hops else -fast / 2, fast],  # [m/s]
        "aside": [-0.4 * fast, 0.4 * fast],
        "sideways": robot.is_free and robot.forward[0] == "x",
        "turns": robot.is_free,
        "rate": f"{rate:.2g}",
        "push": f"{push * robot.mass:.2g}",
        "fall_lead": f"{1.7 * (robot.height / robot.gravity) ** 0.5:.2g}",  # of a pendulum [s]
        "biped": two,
        "iterations": 30 if robot.hops else 26 if two else 22,
        "solves": 3 if two else 2,  # DDP iterations
        "new_solves": 24 if two else 16,
        "unlimited": dict.fromkeys(_places(robot), np.inf),
        "mirror": _mirror(robot),
    }


def _scored(robot: _Robot) -> dict[str, Any]:
    """Returns what is measured and scored, by the sensors that are added."""
    model, data, legs, leg = robot.model, robot.data, bool(robot.feet), robot.leg
    axis, sign = robot.forward
    reached, leans = _reached(robot), _leans(robot)
    goes = legs or (bool(robot.base) and reached is None)
    own = data.geom_xpos[robot.in_tree(model.geom_bodyid)]
    length = float(f"{np.ptp(own, axis=0).max(initial=0.0):.1g}" if own.size else 0.0) or 0.1
    speed = 0.5 * length if robot.kind == "swimmer" else 1.0  # half its length in a second [m/s]
    feet, steps = list[str](), list[str]()
    when, still = "", list[str]()
    if robot.hops:  # it stands as it starts
        when, at = ", when: moving", model.jnt_qposadr
        places = {model.joint(j).name: data.qpos[at[j]] for j in robot.joints}
        still = [f"sensor: {j}/position, target: {_flow(q)}" for j, q in places.items()]
    for i, foot in enumerate(robot.feet):  # they swing in turn, at the clock's rhythm
        name = _flow(_new(robot, f"foot_{i + 1}"))
        rest = data.geom_xpos[foot, 2] - _ground(robot)  # its height while it is down
        swing = _flow({"swing": 0.12 * leg, "phase": 0.5 * (i % 2), "rest": rest})
        feet.append(f"{name}: {{type: framepos, geom: {_flow(model.geom(foot).name)}}}")
        weight = _flow((240.0 if robot.is_biped else 120.0) / leg**2)
        steps.append(f"{{sensor: {name}, index: z, target: {swing}, weight: {weight}{when}}}")
    balls = [
        f"{_flow(_new(robot, name + '_turn'))}: {_flow({'type': 'ballquat', 'joint': name})}"
        for name in _balls(robot)
    ]
    return {
        "root": _flow(robot.name),
        "goes": goes,
        "axis": axis,
        "speed": sign * speed,
        "per_speed": speed**-2,
        "rises": robot.height > 0.0,
        "height": robot.height,
        "low": 0.55 * robot.height,
        "lifts": (105.0 if robot.is_biped else 40.0) / leg**2 if legs else 10.0,
        "turning": 15 if robot.is_biped else 5,
        "leans": ["xyz"[i] for i in leans],
        "upright": [robot.frame[2, i] for i in leans],
        "steadies": 50 if robot.is_biped else 20 if legs else 5,
        "stands": robot.height > 0.0 and robot.frame[2, 2] > 0.9,
        "feet": feet,
        "steps": [*steps, *(f"{{{term}, weight: 5, when: still}}" for term in still)],
        "reached": reached,
        "ways": _ways(robot) if reached else [],
        "balls": balls,
        "axes": [
            f"{_flow(_new(robot, f'{name}_axis'))}: {_flow(axis.sensor)}"
            for name, axis in _upright(robot).items()
        ],
        "added": goes or reached or balls or leans or bool(_upright(robot)),
        "pose": [] if robot.base else [_flow(term) for term in _pose_cost(robot)],
        "controls": [_flow(term) for term in _control_cost(robot)],
    }


def _begin(robot: _Robot) -> dict[str, Any]:
    """Returns which first motion it gets, one of five."""
    controls = controls_of(robot.model) if robot.model.nu else None
    is_servo = controls is not None and set(controls.kinds) == {ControlKind.POSITION}
    path = robot.is_biped and controls is not None and not is_servo
    held = bool(robot.height) or (robot.kind in ("arm", "hand") and is_servo)
    high = controls.limits[1] if controls else np.full(1, np.inf)
    std = np.where(np.isfinite(high) & (high > 0), 0.2 * high, 1.0).tolist()
    sampled = robot.hops and bool((np.isfinite(high) & (high > 0)).all())
    swings = robot.kind == "pendulum" or _carries(robot)
    return {
        "hops": robot.hops,
        "path": path,
        "sampled": sampled,
        "pd": held and not path and not sampled and not swings,
        "noise": None if held or swings else std if len({*std}) > 1 else std[0],
        "swings": swings,
    }


def _strength(robot: _Robot, joint: int) -> float:
    """Returns a limit for a joint's motor [N·m]: what the model allows, or what its load asks."""
    model, data = robot.model, robot.data
    if known := (robot.strengths or {}).get(model.joint(joint).name):
        return known
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    body, is_leg = int(model.jnt_bodyid[joint]), any(joint in leg for leg in _legs(robot))
    far = float(np.linalg.norm(data.subtree_com[body] - data.xanchor[joint]))
    carried = 0.5 * robot.mass * robot.leg
    load = max(3 * model.body_subtreemass[body] * far, carried if is_leg else 0.0)
    return float(f"{(robot.gravity or 9.81) * load:.2g}")


def _places(robot: _Robot) -> list[str]:
    """Returns the cyclic positions, in which nothing differs, but a height."""
    names = [deviation_names(robot.model)[i] for i in cyclic_positions(robot.model)]
    joint = robot.model.joint(robot.base[0]).name if robot.base else ""
    # A height in which nothing differs in the model matters once there is a floor.
    return [name for name in names if not (robot.height and name == f"{joint}/z")]


def _mirror(robot: _Robot) -> list[str]:
    """Returns the exchange of left and right, if places and axes of joints tell it, and names."""
    model, data, joints = robot.model, robot.data, robot.joints
    if not robot.is_free or len(robot.feet) < 2 or robot.forward[0] != "x":
        return []
    anchors = (data.xanchor - data.xpos[robot.root]) @ robot.frame
    axes = data.xaxis @ robot.frame
    motors = {joint: model.actuator(i).name for i, joint in robot.motors.items()}
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
    up, turning, velocity = (_new(robot, name) for name in ("up", "turning", "velocity"))
    pairs |= {up: up, turning: turning}
    if any(exchanged(a, sorted(swaps)) != b for a, b in pairs.items()):
        return []
    flips += [f"{velocity}/y"] if robot.is_biped else []
    flips += [f"{up}/y", f"{turning}/[xz]", "command/sideways", "command/turn", "clock/*"]
    return [f"swap: {_flow([list(pair) for pair in sorted(swaps)])}", f"flip: {_flow(flips)}"]


def _new(robot: _Robot, name: str) -> str:
    """Returns the name of a new sensor, which the model does not have yet."""
    taken = {robot.model.sensor(i).name for i in range(robot.model.nsensor)}
    return f"root_{name}" if name in taken else name


def _leans(robot: _Robot) -> list[int]:
    """Returns the numbers of the vertical that change when the robot leans, such as x and y."""
    if not robot.base or not robot.gravity or (robot.kind == "swimmer" and not robot.is_free):
        return []
    hinges = [j for j in robot.base if robot.model.jnt_type[j] == _HINGE]
    axes = np.eye(3) if robot.is_free else robot.model.jnt_axis[hinges]
    turning = np.abs(np.cross(axes, robot.frame[2])).max(axis=0, initial=0.0)
    return [int(i) for i in np.flatnonzero(turning > 1e-6)]


def _balls(robot: _Robot) -> dict[str, list[float]]:
    """Returns the ball joints, with the quaternion of each at the start."""
    model = robot.model
    balls = np.flatnonzero(model.jnt_type == _BALL)
    starts = {model.joint(j).name: robot.data.qpos[model.jnt_qposadr[j] :][:4] for j in balls}
    return {name: values.round(4).tolist() for name, values in starts.items()}


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
    if target is None or robot.kind not in ("arm", "hand", "swimmer") or not own.size:
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


def _carries(robot: _Robot) -> bool:
    """Returns whether it brings a thing that falls to the target."""
    return bool(robot.gravity) and _reached(robot) is not None and _object(robot) is not None


def _soft(robot: _Robot) -> float:
    """Returns a time constant of contact that can be differentiated [s].

    What lies on it sinks in by g τ², which may be a tenth of a thing that is to be caught.
    """
    model, thing = robot.model, _object(robot)
    if thing is None or not _carries(robot):
        return 0.04
    own = (model.geom_bodyid == model.jnt_bodyid[thing]) & _touching(model)
    size = float(model.geom_size[own, 0].min(initial=np.inf))
    least = 2.0 * model.opt.timestep  # below which MuJoCo's contact is unstable
    return float(np.clip(np.sqrt(0.1 * size / robot.gravity), least, 0.04))


def _ways(robot: _Robot) -> list[str]:
    """Returns the axes along which anything that joints carry can move, as all but y in a plane."""
    model, data = robot.model, mujoco.MjData(robot.model)
    rng, places = np.random.default_rng(0), []
    for _ in range(3):
        mujoco.mj_integratePos(model, data.qpos, rng.standard_normal(model.nv), 0.3)
        mujoco.mj_kinematics(model, data)
        places.append(data.geom_xpos[model.body_weldid[model.geom_bodyid] > 0].copy())
    return ["xyz"[i] for i in np.flatnonzero(np.ptp(places, axis=0).max(axis=0) > 1e-6)]


def _turning(robot: _Robot) -> list[int]:
    """Returns the hinges of a pendulum that turn without end, so that sine and cosine count."""
    is_one = robot.kind == "pendulum"
    return [j for j in robot.hinges if is_one and not robot.model.jnt_limited[j]]


@dataclass(frozen=True)
class _Axis:
    """An axis of a link that shall point somewhere in the world.

    Attributes:
        sensor: the sensor's type and body.
        target: where it points at the goal.
        weight: the link's share of what is lifted.
    """

    sensor: dict[str, Any]
    target: list[float]
    weight: float


def _upright(robot: _Robot) -> dict[str, _Axis]:
    """Returns what of a pendulum's links shall stand, by the hinge of each.

    A link's direction in the world counts, not the angle of its hinge: so a link at the end of
    others may swing as they need it, and each counts as much as gravity does about its hinge.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.goal
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    found = dict[int, tuple[str, Array, float]]()
    turning = _turning(robot)
    for j in turning:
        body = int(model.jnt_bodyid[j])
        axes = data.xmat[body].reshape(3, 3).T
        axes[np.abs(axes @ data.xaxis[j]) > 0.7] = 0.0  # those that a turn does not move
        i = int(np.abs(axes[:, 2]).argmax())
        own, place = float(model.body_mass[body]), data.xanchor[j]
        moment = own * (data.xipos[body] - place)
        for child in np.flatnonzero(model.body_parentid == body):
            hinges = [k for k in turning if model.jnt_bodyid[k] == child]
            at = data.xanchor[hinges[0]] if hinges else data.subtree_com[child]
            moment = moment + model.body_subtreemass[child] * (at - place)
        is_level = abs(data.xaxis[j][2]) > 0.7  # gravity does not turn it
        if not is_level and (size := float(np.linalg.norm(moment))) > 1e-9:
            found[j] = ("xyz"[i], axes[i].round(3), size)
    total = sum((size for *_, size in found.values()), 0.0)
    return {
        model.joint(j).name: _Axis(
            {"type": f"frame{axis}axis", "xbody": model.body(model.jnt_bodyid[j]).name},
            target.tolist(),
            float(f"{size / total:.3f}"),
        )
        for j, (axis, target, size) in found.items()
    }


def _pose_cost(robot: _Robot) -> list[dict[str, Any]]:
    """Returns the cost of a robot that stays in its place: its goal, and rest there.

    What it shall do to a thing beside it is not known: as a guess, it turns it.
    """
    model, terms, thing = robot.model, list[dict[str, Any]](), _object(robot)
    has_target, is_pendulum = _reached(robot) is not None, robot.kind == "pendulum"
    is_turned = thing is not None and model.jnt_type[thing] != _SLIDE and not has_target
    turning, upright = _turning(robot), _upright(robot)
    for name, axis in upright.items():
        stands = {"sensor": _new(robot, f"{name}_axis"), "target": axis.target}
        terms.append(stands | {"weight": axis.weight})
    for j in robot.joints:
        name, goal = model.joint(j).name, robot.goal[model.jnt_qposadr[j]]
        if j in turning:
            for wave, to in (("cos", np.cos(goal)), ("sin", np.sin(goal))):
                term = {"sensor": f"{name}/{wave}", "target": round(float(to), 3)}
                terms += [] if name in upright else [term | {"weight": 0.1}]
        elif not (has_target or is_turned):
            weight = 0.1 if is_pendulum else 1.0
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


def _observed(robot: _Robot) -> list[Any]:
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
        entries += [_new(robot, "velocity")] if robot.is_biped else []
    elif robot.is_free:
        joint = model.joint(robot.base[0]).name
        entries += [*(f"{joint}/{rate}" for rate in ("z", "vx", "vy", "vz")), *_rates(joint)]
    for name in _balls(robot):
        entries += [_new(robot, name + "_turn"), *_rates(name)]
    entries += [_new(robot, "to_target")] if _reached(robot) else []
    lagging = (model.actuator(int(i)).name for i in np.flatnonzero(model.actuator_actnum == 1))
    entries += [f"{name}/activation" for name in lagging]
    entries += ["commands", "clock"] if robot.feet else []
    return entries


def _rates(joint: str) -> list[str]:
    return [f"{joint}/{rate}" for rate in ("wx", "wy", "wz")]
