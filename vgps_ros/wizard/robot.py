# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds out what a robot is for, and where it starts, from its model alone.

That follows from its tree of bodies, its base, its mass and its actuators; names count only where
one says `target`.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.robot.controls import Mask
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import cyclic_positions, deviation_names

_DENSE = 100.0  # density from which on a medium is a liquid [kg/m³]
_STILL = 1e-3  # speed of a joint up to which damping holds it [m/s, rad/s]
FREE, BALL, SLIDE, HINGE = range(4)  # as in mjtJoint


@dataclass
class Robot:
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
    box: dict[str, list[float]] = field(default_factory=dict)  # of its tip: middle, ends [m]
    reach: float = 0.0  # the length of an arm [m]
    strengths: dict[str, float] | None = None  # of joints whose actuators servos replace [N·m]

    @property
    def leg(self) -> float:
        """The height of its hips [m], by which speeds, steps and weights scale."""
        first = (_bending_joints(self, leg)[:1] for leg in legs_of(self))
        hips = [self.data.xanchor[j][2] for joints in first for j in joints]
        return max([h - ground_of(self) for h in hips], default=self.height)

    @property
    def time(self) -> float:
        """Its unit of time, √(l/g) of its legs [s]."""
        return float((self.leg / self.gravity) ** 0.5)

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
        return any(self.model.jnt_type[j] == FREE for j in self.base)

    @property
    def motors(self) -> dict[int, int]:
        """The joint of each actuator that drives one by itself."""
        own = np.flatnonzero(self.model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
        return {int(i): int(self.model.actuator_trnid[i, 0]) for i in own}

    @property
    def is_biped(self) -> bool:
        """Whether it has two feet, of which none stands a leg's length before the other.

        Only feet side by side count, not one before the other as of a cheetah.
        """
        places = self.data.geom_xpos[self.feet] @ self.frame[:, "xyz".index(self.forward[0])]
        return len(places) == 2 and bool(abs(places[0] - places[1]) < self.leg)

    @property
    def hops(self) -> bool:
        """Whether it has one leg."""
        return len(self.feet) == 1

    @property
    def joints(self) -> list[int]:
        """The hinges and slides of its tree that are not its base."""
        kinds, bodies = self.model.jnt_type, self.model.jnt_bodyid
        own = np.flatnonzero((kinds >= SLIDE) & self.in_tree(bodies) & ~_held_joints(self.model))
        return [int(j) for j in own if j not in self.base]

    @property
    def hinges(self) -> list[int]:
        """The hinges among them."""
        return [j for j in self.joints if self.model.jnt_type[j] == HINGE]

    @property
    def frame(self) -> Array:
        """The root's axes as columns, shape (3, 3)."""
        return np.array(self.data.xmat[self.root].reshape(3, 3))

    def new_sensor(self, name: str) -> str:
        """Returns the name of a sensor that the model does not have yet."""
        taken = {self.model.sensor(i).name for i in range(self.model.nsensor)}
        return f"root_{name}" if name in taken else name

    def cyclic_places(self) -> list[str]:
        """Returns the positions that make no difference, as those along the ground."""
        names = [deviation_names(self.model)[i] for i in cyclic_positions(self.model)]
        joint = self.model.joint(self.base[0]).name if self.base else ""
        # A height in which nothing differs in the model matters once there is a floor.
        return [name for name in names if not (self.height and name == f"{joint}/z")]

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

    def reset(self, key: int | None) -> "Robot":
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
            place = slice(first, first + {FREE: 7, BALL: 4}.get(int(model.jnt_type[j]), 1))
            if not np.allclose(self.data.qpos[place], before[place], atol=1e-4):
                values = self.data.qpos[place].round(4).tolist()
                found[model.joint(j).name] = values if len(values) > 1 else values[0]
        return found


@lru_cache(maxsize=2)  # of a model, which is the same only if it is one
def recognise_robot(model: mujoco.MjModel) -> Robot:
    """Returns the facts about a model; its kind decides how it starts, and what its goal is."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    driven = {int(i) for i in data.moment_colind[: int(data.moment_rownnz.sum())]}
    single = {int(i) for i in model.jnt_dofadr[model.jnt_type >= SLIDE]}
    trees = model.dof_treeid[[*(driven or single)]]
    if not (trees >= 0).any():
        raise InvalidInputError(
            "--model: no actuator drives a joint, and there is no hinge or slide that a motor "
            "could drive; name a model of a robot."
        )
    tree = int(np.bincount(trees[trees >= 0]).argmax())
    root = int(np.flatnonzero(model.body_treeid == tree)[0])
    first = [int(j) for j in model.body_jntadr[root] + np.arange(model.body_jntnum[root])]
    held = _held_joints(model)
    base = [j for j in first if model.jnt_dofadr[j] not in driven and not held[j]]
    free = any(model.jnt_type[j] == FREE for j in base)
    slides = any(model.jnt_type[j] == SLIDE for j in base) and (model.nu or len(first) > 1)
    base = base if free or slides else []
    flags = model.opt.disableflags
    gravity = 0.0 if flags & mujoco.mjtDisableBit.mjDSBL_GRAVITY else abs(model.opt.gravity[2])
    trees = [tree] if base or not driven else trees[trees >= 0].tolist()
    for ends in loops_of(model):  # what a loop ties to it is a part of it
        tied = [int(model.body_treeid[end]) for end in ends]
        trees += [i for i in tied if i >= 0] if {*tied} & {*trees} else []
    robot = Robot(model, data, root, trees, base, driven or single, float(gravity))
    if not model.nu and not robot.joints:
        raise InvalidInputError(
            "--model: nothing but its base moves, and no actuator drives that; name a model with "
            "links and motors. Where a program adds them, save the MJCF that it makes."
        )
    ups = [round(robot.reset(key).frame[2, 2], 1) for key in range(model.nkey)]
    key = int(np.argmax(ups)) if ups else None
    robot.reset(None if key is None or np.allclose(model.key_qpos[key], model.qpos0) else key)
    if not base:
        _keep_limits(robot)
    if base and (model.opt.density > _DENSE or model.opt.viscosity > 1e-3):
        robot.kind = "swimmer"
    elif base:
        robot.kind = "vehicle"
        if robot.gravity and _height_index(robot) is not None:
            _stand_on_ground(robot)
        if robot.key is not None and (not robot.feet or _is_crouching(robot)):
            stands = robot.reset(None).frame[2, 2] > 0.9
            if stands:
                _stand_on_ground(robot)
            if not (stands and robot.feet):
                _stand_on_ground(robot.reset(key))
    elif robot.gravity and any(_is_moved_by_gravity(robot, j) for j in robot.joints):
        robot.kind = "pendulum"
    elif finger_count(robot) > 2:
        robot.kind = "hand"
    _set_forward(robot)
    _set_goal(robot)
    return robot


def _held_joints(model: mujoco.MjModel) -> Mask:
    """Returns which slides and hinges damping holds: the model's whole weight hardly moves them."""
    weight = float(model.body_mass.sum() * np.linalg.norm(model.opt.gravity))
    arms = np.where(model.jnt_type == HINGE, model.stat.extent, 1.0)
    found: Mask = model.dof_damping[model.jnt_dofadr] * _STILL > weight * arms
    return found & (model.jnt_type >= SLIDE)


def _is_moved_by_gravity(robot: Robot, joint: int) -> bool:
    """Returns whether gravity moves a hinge: there is no motor, spring or loop, or it is weak."""
    model = robot.model
    if model.jnt_type[joint] != HINGE:
        return False
    if model.jnt_dofadr[joint] in robot.driven:
        return _is_weak(robot, joint)
    return not np.any(model.jnt_stiffness[joint]) and not _is_tied(robot, joint)


def _is_tied(robot: Robot, joint: int) -> bool:
    """Returns whether a hinge follows another one, or turns in a loop of bodies."""
    model, body = robot.model, int(robot.model.jnt_bodyid[joint])
    follows = model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
    if joint in model.eq_obj1id[follows] or joint in model.eq_obj2id[follows]:
        return True
    loops = ([robot.chain(end) for end in ends] for ends in loops_of(model))
    return any((body in one) != (body in other) for one, other in loops)


def loops_of(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Returns the two bodies at which each loop of bodies is closed."""
    found = list[tuple[int, int]]()
    for i, kind in enumerate(map(mujoco.mjtEq, model.eq_type)):
        if kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            is_site = model.eq_objtype[i] == mujoco.mjtObj.mjOBJ_SITE
            ends = [int(model.eq_obj1id[i]), int(model.eq_obj2id[i])]
            one, other = (int(model.site_bodyid[end]) if is_site else end for end in ends)
            found.append((one, other))
    return found


def _is_weak(robot: Robot, joint: int) -> bool:
    """Returns whether a hinge turns without end, and gravity overcomes its motors on the way.

    Not where the robot has a thing beside it, which it is for.
    """
    model, data = robot.model, robot.data
    motors = [i for i, j in robot.motors.items() if j == joint]
    if model.jnt_limited[joint] or not motors or free_object_joint(robot) is not None:
        return False
    start, place, pull = data.qpos.copy(), model.jnt_qposadr[joint], 0.0
    for angle in np.linspace(0.0, 2 * np.pi, 8, endpoint=False):
        data.qpos[place] = angle
        mujoco.mj_forward(model, data)
        pull = max(pull, abs(data.qfrc_bias[model.jnt_dofadr[joint]]))
    data.qpos[:] = start
    mujoco.mj_forward(model, data)
    return bool(pull > controls_of(model).largest[motors].sum())


def weak_motors(robot: Robot) -> list[int]:
    """Returns the actuators of hinges that need several swings to come up."""
    return [i for i, j in robot.motors.items() if _is_weak(robot, j)]


def swing_time(robot: Robot) -> float:
    """Returns the time in which a pendulum swings up and then stands for a while [s].

    Weak motors need several swings: they pull with all their force in the direction in which their
    joints turn, until the energy is that of the goal. Nobody swings up faster.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    weak = weak_motors(robot)
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


def finger_count(robot: Robot) -> int:
    """Returns the number of branches of at least two hinges from which nothing branches off."""
    bodies = np.unique(robot.model.jnt_bodyid[robot.joints])
    chains = [robot.chain(int(body)) for body in bodies]
    passed = [body for chain in chains for body in chain]
    ends = [chain for chain in chains if chain and passed.count(chain[0]) == 1]
    all_ends = [body for chain in ends for body in chain]
    dofs = robot.model.jnt_dofadr
    moved = (j for j in robot.hinges if dofs[j] in robot.driven or not _is_tied(robot, j))
    hinged = [int(robot.model.jnt_bodyid[j]) for j in moved]
    own = [[body for body in chain if all_ends.count(body) == 1] for chain in ends]
    return sum(sum(hinged.count(body) for body in chain) > 1 for chain in own)


def free_object_joint(robot: Robot) -> int | None:
    """Returns the first joint of another tree, which the robot may move."""
    model = robot.model
    joints = (j for j in range(model.njnt) if not robot.in_tree(model.jnt_bodyid[j]))
    named = (j for j in joints if "target" not in model.body(model.jnt_bodyid[j]).name)
    return next((j for j in named if model.jnt_dofadr[j] not in robot.driven), None)


def _height_index(robot: Robot) -> int | None:
    """Returns the place in qpos of the base's height."""
    model = robot.model
    for j in robot.base:
        is_free = model.jnt_type[j] == FREE
        if is_free or (model.jnt_type[j] == SLIDE and abs(robot.data.xaxis[j][2]) > 0.5):
            return int(model.jnt_qposadr[j] + 2 * is_free)
    return None


def _stand_on_ground(robot: Robot) -> None:
    """Sets the start of a robot that gravity holds on the ground: within its limits, knees bent.

    Its feet are what of its outermost bodies is lowest.
    """
    model, data = robot.model, robot.data
    original = data.qpos.copy()
    _keep_limits(robot)
    robot.feet = _find_feet(robot)
    if robot.feet:
        _bend_knees(robot, original)
        robot.feet = _find_feet(robot)
    lowest = float(bottoms_of(robot).min(initial=np.inf))
    if np.isfinite(lowest):
        depth, height = ground_of(robot) - lowest, data.xpos[robot.root][2] - lowest
        hovers = robot.feet and 0.04 < -depth / height < 2.0
        data.qpos[_height_index(robot)] += depth if depth > 0.004 * height or hovers else 0.0
    mujoco.mj_forward(model, data)
    robot.height = float(data.xpos[robot.root][2] - ground_of(robot))
    if robot.feet:
        robot.kind = "legs"


def _keep_limits(robot: Robot) -> None:
    """Sets joints that start beyond their limits to a quarter of their range inside them."""
    model, data = robot.model, robot.data
    for j in robot.joints:
        place, (low, high) = model.jnt_qposadr[j], model.jnt_range[j]
        if model.jnt_limited[j] and not low - 1e-6 <= data.qpos[place] <= high + 1e-6:
            share = 0.25 * (high - low)
            data.qpos[place] = np.clip(data.qpos[place], low + share, high - share)
    mujoco.mj_forward(model, data)


def _is_crouching(robot: Robot) -> bool:
    """Returns whether its hips are lower than half the length of its legs."""
    for foot, leg in zip(robot.feet, legs_of(robot), strict=True):
        bending = _bending_joints(robot, leg)
        points = [*robot.data.xanchor[bending], robot.data.geom_xpos[foot]]
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        if points[0][2] - ground_of(robot) < 0.5 * length:
            return True
    return False


def touching_geoms(model: mujoco.MjModel) -> Mask:
    """Returns whether each geom may touch anything."""
    found: Mask = (model.geom_contype | model.geom_conaffinity) != 0
    found[np.concatenate([model.pair_geom1, model.pair_geom2]).astype(int)] = True
    return found


def ground_of(robot: Robot) -> float:
    """Returns the height of the level planes, or of a height field under the root, or 0 [m]."""
    model, data, heights = robot.model, robot.data, [0.0]
    heights += data.geom_xpos[ground_planes(robot), 2].tolist()
    for i in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD):
        top = data.geom_xpos[i, 2] + 2.0 * model.stat.extent
        above = np.append(data.xpos[robot.root][:2], top)
        way = mujoco.mj_rayHfield(model, data, i, above, np.array([0.0, 0.0, -1.0]))
        heights += [top - way] * (way >= 0.0)
    return float(max(heights))


def ground_planes(robot: Robot) -> Mask:
    """Returns which geoms are level planes on which something can stand."""
    is_plane = robot.model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    return touching_geoms(robot.model) & is_plane & (robot.data.geom_xmat[:, 8] > 0.9)


def bottoms_of(robot: Robot) -> Array:
    """Returns the height of the lowest point of each of its geoms that may touch, else inf."""
    is_own = robot.in_tree(robot.model.geom_bodyid)
    return np.where(is_own, lowest_points(robot.model, robot.data), np.inf)


def lowest_points(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Returns the height of each geom's lowest point, inf if it touches nothing, shape (ngeom,).

    Those of spheres, capsules, boxes and meshes are exact, others reach as far as their boxes.
    """
    rows = data.geom_xmat[:, 6:]
    boxes = np.abs(rows * model.geom_aabb[:, 3:]).sum(axis=1)
    boxes -= (rows * model.geom_aabb[:, :3]).sum(axis=1)
    meshes = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & touching_geoms(model)
    for geom in np.flatnonzero(meshes):
        mesh = model.geom_dataid[geom]
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        boxes[geom] = -(vertices @ rows[geom]).min()
    is_capsule = model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
    round_ends = model.geom_size[:, 0] + model.geom_size[:, 1] * np.abs(rows[:, 2]) * is_capsule
    is_round = is_capsule | (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
    bottoms = data.geom_xpos[:, 2] - np.where(is_round, round_ends, boxes)
    return np.where(touching_geoms(model), bottoms, np.inf)


def _find_feet(robot: Robot) -> list[int]:
    """Returns a geom of each foot, by the angle around the robot, the left front one first."""
    model, data = robot.model, robot.data
    bottoms = bottoms_of(robot)
    bodies = np.unique(model.geom_bodyid[np.isfinite(bottoms)])
    lowest = float(bottoms.min(initial=np.inf))
    height = data.xpos[robot.root][2] - lowest
    reach = lowest + 0.1 * height if bodies.size else lowest  # a robot may have no shapes
    found = dict[int, int]()
    for body in map(int, np.setdiff1d(bodies, [*model.body_parentid[bodies], robot.root])):
        own = np.flatnonzero((model.geom_bodyid == body) & np.isfinite(bottoms))
        if bottoms[own].min() < reach and not is_wheel(robot, body, own):
            soles = own[bottoms[own] < bottoms[own].min() + 0.02 * height]
            places = data.geom_xpos[soles]
            nearest = np.abs(places - places.mean(axis=0)).sum(axis=1).argmin()
            found[int(model.body_parentid[body])] = int(soles[nearest])
    for geom in list(found.values()):  # what is above a foot on the same leg is none
        for parent in robot.chain(int(model.geom_bodyid[geom]))[1:]:
            if parent in found and bottoms[found[parent]] > bottoms[geom] + 0.04 * height:
                del found[parent]
    centre = data.subtree_com[robot.root] if robot.base else data.xpos[robot.root]
    around = {i: np.arctan2(*(data.geom_xpos[i] - centre)[[1, 0]]) for i in found.values()}
    return sorted(around, key=lambda i: around[i] % (2 * np.pi))


def is_wheel(robot: Robot, body: int, geoms: Any) -> bool:
    """Returns whether a body turns about its own middle, without end."""
    model, data = robot.model, robot.data
    joint = int(model.body_jntadr[body])
    if joint < 0 or model.jnt_type[joint] != HINGE or model.jnt_limited[joint]:
        return False
    arms = np.cross(data.geom_xpos[geoms] - data.xanchor[joint], data.xaxis[joint])
    return bool(np.linalg.norm(arms, axis=1).max() < 0.1 * model.geom_rbound[geoms].max())


def legs_of(robot: Robot) -> list[list[int]]:
    """Returns the hinges of each foot's leg, the hip's first; not what two feet share."""
    model = robot.model
    bodies = [robot.chain(int(model.geom_bodyid[foot])) for foot in robot.feet]
    alone = [[b for b in leg if sum(b in other for other in bodies) == 1] for leg in bodies]
    return [[j for j in robot.hinges if model.jnt_bodyid[j] in leg] for leg in alone]


def _bending_joints(robot: Robot, leg: list[int]) -> list[int]:
    """Returns the hinges that bend a leg: most of them are parallel, as hip, knee and ankle are."""
    axes = {j: robot.data.xaxis[j] for j in leg}
    level = [j for j in axes if abs(axes[j][2]) < 0.5]
    groups = [[k for k in axes if abs(axes[j] @ axes[k]) > 0.9] for j in level]
    return max(groups, key=len, default=[])


def _bend_knees(robot: Robot, original: Array) -> None:
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
    for foot, hinges in zip(robot.feet, legs_of(robot), strict=True):
        wanted, level = places[foot], frames[foot]
        mujoco.mj_kinematics(model, data)
        leg = _bending_joints(robot, hinges)
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


def _set_forward(robot: Robot) -> None:
    """Sets the direction in which a robot goes: that of a swimmer's head, or across its sides.

    One whose feet hardly move in that direction goes in the other.
    """
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
        along, across = _foot_reach(robot)[:2]
        if unlike[0] < 0.1 * unlike[1] or along < 0.1 * across:
            robot.forward = ("y", 1.0)


def _foot_reach(robot: Robot) -> Array:
    """Returns how far hinges move the feet along each of the root's axes [m/rad], shape (3,)."""
    model, found, jacobian = robot.model, np.zeros(3), np.empty((3, robot.model.nv))
    for foot, leg in zip(robot.feet, legs_of(robot), strict=True):
        mujoco.mj_jacGeom(model, robot.data, jacobian, None, foot)
        found += np.abs(robot.frame.T @ jacobian[:, model.jnt_dofadr[leg]]).sum(axis=1)
    return found


def _set_goal(robot: Robot) -> None:
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
            at, way = data.qpos[place], 0.5 if model.jnt_type[j] == HINGE else 0.1
            if model.jnt_limited[j]:  # towards the middle, or away from it
                inwards = (low + high) / 2 - at
                away = min(way, (high - low) / 4)
                way = np.clip(inwards, -way, way) if abs(inwards) > 0.05 else away
            robot.goal[place] = at + way * (model.jnt_dofadr[j] in robot.driven)
        return
    wide = ~model.jnt_limited.astype(bool) | (np.ptp(model.jnt_range, axis=1) > 6.0)
    turning = [j for j in robot.hinges if wide[j]]
    robot.goal, lowest = (_extreme_pose(robot, turning, sign) for sign in (1.0, -1.0))
    if np.allclose(robot.goal, lowest):  # as of a pole that its limits hold up
        lowest[model.jnt_qposadr[[j for j in robot.joints if _is_moved_by_gravity(robot, j)]]] += (
            0.1
        )
    data.qpos[:], robot.key = lowest, None
    mujoco.mj_forward(model, data)


def _extreme_pose(robot: Robot, joints: list[int], sign: float) -> Array:
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
