# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a first task file for a robot, with comments that say what to change."""

import re
from dataclasses import dataclass

import mujoco
import numpy as np

from vgps_ros.simulation.model import control_range, cyclic_positions, deviation_names, joint_names

_PERIOD = 0.01  # the control period is the multiple of the time step nearest to it [s]
_STRONG = 0.1  # what a control at its limit costs in each step
_WEAKEST = 0.5  # height in which a robot has fallen, as a share of the one it starts from


@dataclass(frozen=True)
class _Robot:
    """Facts about a model from which its first task file is written."""

    model: mujoco.MjModel
    root: str  # the body that carries all others
    goes: bool  # whether it can travel, as along a floor
    is_free: bool  # whether it has a free joint, named `joint`
    joint: str
    height: float  # of the root at the start [m]; 0 if it cannot rise or fall
    placed: list[float]  # the free joint's position at the start, if the model's is in the floor
    up: np.ndarray  # the vertical in the root's frame at the start, shape (3,)
    leans: list[int]  # the numbers of `up` that change when the robot leans, such as x and y
    prefix: str  # of the names of new sensors, so that the model has none of them
    balls: dict[str, list[float]]  # the ball joints, with the quaternion of each at the start


def first_task_file(reference: str, model: mujoco.MjModel, schema: str) -> str:
    """Returns the text of a task file for a model, all of whose joints and actuators have names.

    The file names the model by the reference, and a JSON schema by its path, for editors.
    """
    robot = _robot(model)
    limits = control_range(model)[1]
    strengths = limits[limits < 1e6]
    period = _whole(_PERIOD, model.opt.timestep)
    lines = [
        f"# yaml-language-server: $schema={schema}",
        f"# Joints: {_listed([model.joint(i).name for i in range(model.njnt)])}.",
        f"# Actuators: {_listed([model.actuator(i).name for i in range(model.nu)])}.",
        f"# Keyframes: {_listed([model.key(i).name or str(i) for i in range(model.nkey)])}.",
        f"# Sensors: {_listed([model.sensor(i).name for i in range(model.nsensor)])}.",
        "# After a change, `vgps check task.yaml` says what looks wrong.",
        f"model: {reference}",
        *_changes(model, robot.goes),
        f"control_period: {period:g}      # [s], multiple of the time step, {model.opt.timestep:g}",
        f"horizon: {_whole(2.0, period):<5g}             # [s], trained on and scored",
    ]
    if robot.goes:
        lines.append(f"lookahead: {_whole(0.5, period):<5g}           # [s], optimised beyond it")
    lines += [*_start(robot), *_sensors(robot), *_cost(robot, strengths), *_observed(robot)]
    is_upright = bool(robot.leans) and robot.up[2] > 0.9
    if robot.height or is_upright:
        lines.append("fallen:")
    if robot.height:
        lowest = _WEAKEST * robot.height
        lines += [
            f"  - {{sensor: {robot.prefix}height, index: z, below: {lowest:.2g}}}         # [m]",
        ]
    if is_upright:
        lines.append(f"  - {{sensor: {robot.prefix}up, index: z, below: 0.5}}    # leans by 60°")
    lines += [
        *_begin(robot, strengths),
        "search:                     # a smaller network learns faster, and may miss a contact",
        "  {hidden_units: [32], ddp_iterations: 5}",
    ]
    return "\n".join(lines) + "\n"


def _whole(duration: float, period: float) -> float:
    """Returns the multiple of a period that is nearest to a duration [s]."""
    return max(1, round(duration / period)) * period


def _robot(model: mujoco.MjModel) -> _Robot:
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    body = _root(model)
    first = int(model.body_jntadr[body])
    is_free = model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE
    goes = bool(is_free or cyclic_positions(model))
    falls = goes and abs(model.opt.gravity[2]) > 0
    mujoco.mj_kinematics(model, data)
    placed: list[float] = []
    if falls and is_free and not model.nkey and (depth := _depth(model, data, body)) > 0.0:
        place = slice(model.jnt_qposadr[first], model.jnt_qposadr[first] + 7)
        data.qpos[place.start + 2] += depth
        placed = [round(float(value), 4) for value in data.qpos[place]]
        mujoco.mj_kinematics(model, data)
    up = data.xmat[body].reshape(3, 3)[2]
    taken = " ".join(model.sensor(i).name for i in range(model.nsensor))
    balls = {}
    for i in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL):
        first_of_ball = model.jnt_qposadr[i]
        quaternion = data.qpos[first_of_ball : first_of_ball + 4]
        balls[model.joint(i).name] = [round(float(value), 4) for value in quaternion]
    turning = np.abs(np.cross(_axes(model, body), up)).max(axis=0, initial=0.0)
    return _Robot(
        model=model,
        root=model.body(body).name or str(body),
        goes=goes,
        is_free=bool(is_free),
        joint=model.joint(first).name,
        height=float(data.xpos[body][2]) if falls else 0.0,
        placed=placed,
        up=up,
        prefix="root_" if re.search(r"\b(velocity|height|up|\w+_turn)\b", taken) else "",
        leans=[int(i) for i in np.flatnonzero(turning > 1e-6)] if falls else [],
        balls=balls,
    )


def _root(model: mujoco.MjModel) -> int:
    """Returns the first body of the tree that has most actuators; a ball or a box has none."""
    joints = [i for i in model.actuator_trnid[:, 0] if 0 <= i < model.njnt]
    driven = [model.body_treeid[model.jnt_bodyid[i]] for i in joints]
    tree = max(range(max(1, model.ntree)), key=driven.count)
    return int(np.flatnonzero(model.body_treeid == tree)[0])


def _depth(model: mujoco.MjModel, data: mujoco.MjData, root: int) -> float:
    """Returns how far a robot reaches below the ground at height 0 or the model's planes [m]."""
    touching = (model.geom_contype | model.geom_conaffinity) != 0
    trees = model.body_treeid[model.geom_bodyid]
    planes = touching & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    ground = float(data.geom_xpos[planes, 2].max(initial=0.0))
    lowest = np.inf
    for i in np.flatnonzero(touching & (trees == model.body_treeid[root])):
        axes, size = data.geom_xmat[i].reshape(3, 3)[2], model.geom_size[i]
        kind = mujoco.mjtGeom(model.geom_type[i])
        if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
            reach = size[0] + size[1] * abs(axes[2]) * (kind == mujoco.mjtGeom.mjGEOM_CAPSULE)
            lowest = min(lowest, data.geom_xpos[i, 2] - reach)
        else:  # at most as far as its box
            centre, half = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
            lowest = min(lowest, data.geom_xpos[i, 2] + axes @ centre - np.abs(axes) @ half)
    return float(np.ceil(1e3 * (ground - lowest)) / 1e3) if np.isfinite(lowest) else 0.0


def _axes(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Returns the axes about which a body turns, in its own frame, shape (N, 3)."""
    joints = model.body_jntadr[body] + np.arange(model.body_jntnum[body])
    kinds = model.jnt_type[joints]
    if np.isin(kinds, (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL)).any():
        return np.eye(3)
    return model.jnt_axis[joints[kinds == mujoco.mjtJoint.mjJNT_HINGE]]


def _changes(model: mujoco.MjModel, goes: bool) -> list[str]:
    lines = []
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        lines.append("  option: {integrator: implicitfast}     # stiff joints stay stable")
    touching = ((model.geom_contype | model.geom_conaffinity) != 0).any()
    if touching and not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
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
    if goes and not has_ground and abs(model.opt.gravity[2]) > 0:
        lines.append("  floor: true                            # the model has none")
    if not model.nu:
        lines.append("  actuators:                             # motors [N·m]; the model has none")
        lines += [f"    {name}: {{joint: {name}, limit: 20.0}}" for name in _driven(model)]
    heading = "changes:                    # made in memory, the model's file stays"
    return [heading, *lines] if lines else []


def _driven(model: mujoco.MjModel) -> list[str]:
    """Returns the joints that a motor may drive: not those that carry the whole robot along."""
    first = _root(model)
    base = model.body_jntadr[first] + np.arange(model.body_jntnum[first])
    carried = {model.joint(j).name for j in base if len(base) > 1}
    return [name for name in joint_names(model) if name not in carried]


def _start(robot: _Robot) -> list[str]:
    model = robot.model
    names = deviation_names(model)
    # A height in which nothing differs in the model matters once there is a floor.
    places = [names[i] for i in cyclic_positions(model)]
    exact = [name for name in places if not (robot.height and name == f"{robot.joint}/z")]
    overrides = f", overrides: {{{', '.join(f'{n}: 0.0' for n in exact)}}}" if exact else ""
    std = f"std: {{position: 0.01, velocity: 0.1{overrides}}}"
    if robot.placed:
        free = f"  positions: {{{robot.joint}: {robot.placed}}}"
        return ["start:", f"{free}    # on the ground", f"  {std}"]
    if not model.nkey:
        return [f"start: {{{std}}}"]
    return ["start:", f"  keyframe: {model.key(0).name or 0}", f"  {std}"]


def _sensors(robot: _Robot) -> list[str]:
    if not (robot.goes or robot.balls):
        return []
    new, root = f"  {robot.prefix}", robot.root
    lines = ["sensors:                    # added to the model's own"]
    lines += [new + f"{name}_turn: {{type: ballquat, joint: {name}}}" for name in robot.balls]
    if not robot.goes:
        return lines
    lines.append(
        new + f"velocity: {{type: subtreelinvel, body: {root}}}    # of the centre of mass [m/s]"
    )
    if robot.height:
        lines.append(new + f"height: {{type: framepos, xbody: {root}}}          # [m]")
    if robot.leans:
        lines += [
            "  # The vertical in the robot's own frame:",
            new + f"up: {{type: framezaxis, xbody: world, relative_to: {{xbody: {root}}}}}",
        ]
    return lines


def _cost(robot: _Robot, strengths: np.ndarray) -> list[str]:
    lines = ["cost:                       # what is wanted, and what it may cost"]
    if robot.goes:
        of = f"  - {{sensor: {robot.prefix}"
        lines.append(of + "velocity, index: x, target: 1.0}        # [m/s] forwards")
        if robot.height:
            lines.append(of + f"height, index: z, target: {robot.height:.3g}, weight: 10.0}}")
        if robot.leans:
            index = ", ".join("xyz"[i] for i in robot.leans)
            target = ", ".join(f"{robot.up[i] + 0.0:.3g}" for i in robot.leans)
            lines.append(of + f"up, index: [{index}], target: [{target}], weight: 5.0}}")
    else:
        joints = joint_names(robot.model)
        lines += [f"  - {{sensor: {name}/position, target: 0.0}}" for name in joints]
        lines += [f"  - {{sensor: {name}/velocity, weight: 0.1}}" for name in joints]
        for name, turn in robot.balls.items():
            lines.append(f"  - {{sensor: {robot.prefix}{name}_turn, target: {turn}}}")
            lines += [f"  - {{sensor: {rate}, weight: 0.1}}" for rate in _rates(name)]
    weight = _STRONG / float(strengths.max()) ** 2 if strengths.size else 1e-3
    lines.append(f"  - {{control: all, weight: {weight:.1e}}}")
    return lines


def _observed(robot: _Robot) -> list[str]:
    model = robot.model
    cyclic = {deviation_names(model)[i].rpartition("/")[0] for i in cyclic_positions(model)}
    out = [name for name in joint_names(model) if name in cyclic]
    positions = f"{{joint_positions: {{except: [{', '.join(out)}]}}}}" if out else "joint_positions"
    entries = [positions, "joint_velocities"] if joint_names(model) else []
    if robot.is_free:
        rates = [f"{robot.joint}/{rate}" for rate in ("z", "vx", "vy", "vz")]
        entries += [*([robot.prefix + "up"] if robot.leans else []), *rates, *_rates(robot.joint)]
    for name in robot.balls:
        entries += [f"{robot.prefix}{name}_turn", *_rates(name)]
    return ["observe:                    # what the policy reads", f"  [{', '.join(entries)}]"]


def _rates(joint: str) -> list[str]:
    return [f"{joint}/{rate}" for rate in ("wx", "wy", "wz")]


def _begin(robot: _Robot, strengths: np.ndarray) -> list[str]:
    if robot.height:
        return ["begin: {law: pd}            # the first motion holds the start"]
    std = 0.2 * float(strengths.min()) if strengths.size else 1.0
    return [f"begin: {{law: noise, std: {std:.2g}, time_constant: 0.3}}   # smooth noise"]


def _listed(names: list[str]) -> str:
    return ", ".join(name for name in names if name) or "none"
