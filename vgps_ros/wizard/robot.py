# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A robot: facts about a model from which its first task file is written."""

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.robot.controls import Mask
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import cyclic_positions, deviation_names

_STILL = 1e-3  # speed of a joint up to which damping holds it [m/s, rad/s]
FREE, BALL, SLIDE, HINGE = range(4)  # as in mjtJoint


@dataclass
class Robot:
    """A robot's model, its start, and what `recognition` found out."""

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
        first = (bending_joints(self, leg)[:1] for leg in legs_of(self))
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
        own = np.flatnonzero((kinds >= SLIDE) & self.in_tree(bodies) & ~held_joints(self.model))
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


def held_joints(model: mujoco.MjModel) -> Mask:
    """Returns which slides and hinges damping holds: the model's whole weight hardly moves them."""
    weight = float(model.body_mass.sum() * np.linalg.norm(model.opt.gravity))
    arms = np.where(model.jnt_type == HINGE, model.stat.extent, 1.0)
    found: Mask = model.dof_damping[model.jnt_dofadr] * _STILL > weight * arms
    return found & (model.jnt_type >= SLIDE)


def is_tied(robot: Robot, joint: int) -> bool:
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


def is_weak(robot: Robot, joint: int) -> bool:
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
    return [i for i, j in robot.motors.items() if is_weak(robot, j)]


def finger_count(robot: Robot) -> int:
    """Returns the number of branches of at least two hinges from which nothing branches off."""
    bodies = np.unique(robot.model.jnt_bodyid[robot.joints])
    chains = [robot.chain(int(body)) for body in bodies]
    passed = [body for chain in chains for body in chain]
    ends = [chain for chain in chains if chain and passed.count(chain[0]) == 1]
    all_ends = [body for chain in ends for body in chain]
    dofs = robot.model.jnt_dofadr
    moved = (j for j in robot.hinges if dofs[j] in robot.driven or not is_tied(robot, j))
    hinged = [int(robot.model.jnt_bodyid[j]) for j in moved]
    own = [[body for body in chain if all_ends.count(body) == 1] for chain in ends]
    return sum(sum(hinged.count(body) for body in chain) > 1 for chain in own)


def free_object_joint(robot: Robot) -> int | None:
    """Returns the first joint of another tree, which the robot may move."""
    model = robot.model
    joints = (j for j in range(model.njnt) if not robot.in_tree(model.jnt_bodyid[j]))
    named = (j for j in joints if "target" not in model.body(model.jnt_bodyid[j]).name)
    return next((j for j in named if model.jnt_dofadr[j] not in robot.driven), None)


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


def bending_joints(robot: Robot, leg: list[int]) -> list[int]:
    """Returns the hinges that bend a leg: most of them are parallel, as hip, knee and ankle are."""
    axes = {j: robot.data.xaxis[j] for j in leg}
    level = [j for j in axes if abs(axes[j][2]) < 0.5]
    groups = [[k for k in axes if abs(axes[j] @ axes[k]) > 0.9] for j in level]
    return max(groups, key=len, default=[])
