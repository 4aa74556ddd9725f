# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a first task file for a robot, with comments that say what to change.

What it does not know, the file says. Here are the facts about the robot that a task needs; what the
robot is for is found in `robot`, and the lines that the facts pick and fill stand in
`first_task.template`.
"""

import json
import re
from copy import copy
from dataclasses import replace
from itertools import product
from pathlib import Path
from string import Template
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.robot.controls import CONTROL_BOUND, ControlKind, Controls
from vgps_ros.simulation.controls import controls_of, resting_controls
from vgps_ros.simulation.model import joint_names
from vgps_ros.tasks.builder import swap_parts
from vgps_ros.tasks.schema import MOST_CONTACTS
from vgps_ros.wizard.legged_scale import legged_numbers, servo_numbers, servo_reach, strongest
from vgps_ros.wizard.model_edits import EditedModel, has_motors_too_strong
from vgps_ros.wizard.robot import (
    BALL,
    FREE,
    HINGE,
    SLIDE,
    Robot,
    bottoms_of,
    finger_count,
    free_object_joint,
    ground_of,
    ground_planes,
    legs_of,
    loops_of,
    recognise_robot,
    swing_time,
    touching_geoms,
    weak_motors,
)

_TEMPLATE = Path(__file__).with_name("first_task.template")
_UNKNOWN_REACH = 0.8  # of a servo whose force has no limit: the target at which it is strong [rad]
_BOXES = (0.2, 0.15, 0.1, 0.05)  # half the width of a tip's box, of the arm's length
_FALLEN = 0.55  # of its height, below which a robot with legs lies
_NEAR = 5.0  # body lengths within which a swimmer is sent to a target
_ALIKE = 0.04  # of a leg, within which two joints' axes are one line
_LOW = 0.15  # of a leg, up to which the middle of a foot that is down lies above the ground
_SENSORS = ("velocity", "turning", "height", "up", "to_target", "tip")  # whose names may be taken
_PERIOD = 0.02  # of control, of what swims or swings [s]
_AT_JOINT = mujoco.mjtTrn.mjTRN_JOINT
_LAGGING = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)  # a first-order lag [s]
_EDITS = ("drop", "floor", "remove_bodies", "free_bodies", "remove_actuators")  # made before
_CHANGES = (*_EDITS, "locks", "options", "contact", "limits", "motors")


def first_task_file(reference: str, edited: EditedModel, schema: str) -> str:
    """Returns the text of a task file for a model, all of whose joints and actuators have names.

    The file names the model by the reference, and a JSON schema by its path, for editors. Servos in
    place of the robot's own actuators are as strong as those are.

    Raises:
        InvalidInputError: no actuator drives a joint, and no joint could have one.
    """
    model, former, changes = edited.model, edited.driven, edited.changes
    robot = replace(recognise_robot(model))
    if former.nu > model.nu:
        largest = controls_of(former).largest
        pairs = zip(former.actuator_trntype, former.actuator_trnid[:, 0], largest, strict=True)
        at_joint = [(former.joint(j).name, force) for kind, j, force in pairs if kind == _AT_JOINT]
        robot.strengths = {name: float(force) for name, force in at_joint if force < CONTROL_BOUND}
    _set_box(robot)
    facts: dict[str, Any] = dict.fromkeys(_EDITS) | changes
    facts |= _template_values(robot, former) | {"schema": schema, "model": reference}
    locks = changes.get("joints", {}).items()
    facts["locks"] = [f"{_flow(name)}: {_flow(values)}" for name, values in locks]
    facts["jointed"] = facts["locks"] or facts["limits"]
    facts["shaken"] = former.nu > model.nu and has_motors_too_strong(former)
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


def _template_values(robot: Robot, former: mujoco.MjModel) -> dict[str, Any]:
    """Returns the facts of which the template speaks; one that is left out counts as false."""
    model, legs = robot.model, bool(robot.feet)
    numbers = legged_numbers(robot) if legs else _general_numbers(robot)
    base = "free" if robot.is_free else "sliding" if robot.base else "fixed"
    moved = robot.moved()
    listed = {
        "joints": [model.joint(i).name for i in range(model.njnt)],
        "actuators": [former.actuator(i).name for i in range(former.nu)],
        "keyframes": [model.key(i).name or str(i) for i in range(model.nkey)],
        "sensors": [model.sensor(i).name for i in range(model.nsensor)],
    }
    return {
        robot.kind: True,
        "robot": f"({robot.mass:.3g} kg, a {base} base, actuators: {former.nu})",
        "weightless": robot.base and not robot.gravity,
        "count": len(robot.feet) or finger_count(robot),
        **{what: ", ".join(filter(None, names)) or "none" for what, names in listed.items()},
        # After its horizon, as it is trained to:
        "goes_on": bool(robot.base or robot.box) or _swings_up(robot),
        "keyframe": None if robot.key is None else listed["keyframes"][robot.key],
        "moved": _flow(moved, 5) if moved else "",
        "seeks": (seeks := _has_target(robot)),
        "measured": seeks or (legs and robot.is_free),
        "swims": "reach what is called target" if seeks else f"go along {robot.forward[0]}",
        "varied": _start_spread(robot) if seeks or robot.box else None,
        "observed": _observations(robot),
        **{name.upper(): _flow(robot.new_sensor(name)) for name in _SENSORS},
        **numbers,
        **{time: f"{numbers[time]:g}" for time in ("step", "period", "horizon", "lookahead")},
        **_model_changes(robot, numbers),
        **_cost_values(robot, numbers),
        **_first_motion_values(robot),
        **(_command_values(robot) if legs else {}),
    }


def _general_numbers(robot: Robot) -> dict[str, Any]:
    """Returns the times and the spread of a robot without legs."""
    step, is_swimmer = robot.model.opt.timestep, robot.kind == "swimmer"
    period = _whole(_PERIOD if is_swimmer or robot.kind == "pendulum" else 0.01, step)
    planned = swing_time(robot) if robot.kind == "pendulum" else 2.0
    if robot.box:
        planned = 3.0 * float((robot.reach / (robot.gravity or 9.81)) ** 0.5)
        period = _whole(planned / 50, step)
    swings = 0.75 * planned if _swings_up(robot) else 0.0  # a plan's end needs no feedback
    horizon = _whole(3.0 if is_swimmer else swings or planned, period)
    same = [] if _has_target(robot) else robot.cyclic_places()
    return {
        "step": step,
        "period": period,
        "horizon": horizon,
        "twice": 2 * (planned if swings else horizon),
        "lookahead": _whole(1.0 if is_swimmer else 0.5 if robot.base else planned / 4, period),
        "std": {"position": 0.01, "velocity": 0.1}
        | ({"overrides": dict.fromkeys(same, 0.0)} if same else {}),
        "soft": float(f"{_contact_time(robot):.2g}"),
        "contact_width": 0.02,
        "soft_limit": 0.04,
        "lifts": 10.0,
        "steadies": 5.0,
    }


def _model_changes(robot: Robot, numbers: dict[str, Any]) -> dict[str, Any]:
    """Returns what is changed of the model."""
    model, option, step = robot.model, robot.model.opt, numbers["step"]
    touches = bool(not option.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT)
    touches &= bool(touching_geoms(model).any())
    is_round = touches and option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
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
        "cone": ("pyramidal", not is_round),
    }
    options = {name: value for name, (value, has) in wanted.items() if not has}
    groups = dict[float, list[str]]()
    for j in [] if model.nu else robot.joints:
        groups.setdefault(_strength(robot, j), []).append(model.joint(j).name)
    motors = []
    for limit, names in groups.items():
        motor: dict[str, Any] = {"joint": names if len(names) > 1 else names[0]}
        if robot.feet or robot.strengths is not None:  # damped as a gear damps
            motor |= servo_numbers(robot, limit)
        key = f"up_to_{limit:g}" if len(names) > 1 else names[0]
        motors.append(f"{_flow(key)}: {_flow(motor | {'limit': limit})}")
    return {
        "options": _flow(options, 6) if options else "",
        "contact": touches,
        "limits": (model.jnt_limited.astype(bool) & (model.jnt_solimp[:, 0] > 0.0)).any(),
        "motors": motors,
        "servos": bool(robot.feet) or robot.strengths is not None,
        "only": _foot_contacts(robot) if touches else None,
    }


def _foot_contacts(robot: Robot) -> list[list[str]]:
    """Returns the pairs of a ground and a foot, if all have names and nothing else moves."""
    model = robot.model
    if not robot.in_tree(model.dof_bodyid).all():  # a target, which `edit_model` leaves
        return []
    feet = np.isin(model.geom_bodyid, model.geom_bodyid[robot.feet])
    feet &= bottoms_of(robot) < ground_of(robot) + 0.1 * robot.leg
    grounds = ground_planes(robot)
    if not grounds.any():
        grounds = (model.body_weldid[model.geom_bodyid] == 0) & touching_geoms(model)
    sides = [[model.geom(i).name for i in np.flatnonzero(these)] for these in (grounds, feet)]
    pairs = [[ground, foot] for ground in sides[0] for foot in sides[1]]
    return pairs if all(map(all, sides)) and len(pairs) <= MOST_CONTACTS else []


def _command_values(robot: Robot) -> dict[str, Any]:
    """Returns what a robot with legs is told: commands, the clock of its gait, and its mirror."""
    return {
        "sideways": robot.is_free and robot.forward[0] == "x",
        "turns": robot.is_free,
        # The cheaper a late control is, the wilder would be its noise, which learning must hear
        # the motion through.
        "alphas": [scale * _lag_gains(robot).max(initial=1.0) for scale in (0.4, 1.2)],
        "mirror": _mirror(robot),
    }


def _lag_gains(robot: Robot) -> Array:
    """Returns the squared gain that compensates each actuator's lag at the clock's rate.

    An actuator that lags needs larger commands, the faster the robot steps.
    """
    rate = legged_numbers(robot)["rate"] if robot.feet else 0.0
    kinds, numbers = robot.model.actuator_dyntype, robot.model.actuator_dynprm
    lags = np.isin(kinds, [int(kind) for kind in _LAGGING])
    return np.asarray(1.0 + (2 * np.pi * rate * np.where(lags, numbers[:, 0], 0.0)) ** 2)


def _cost_values(robot: Robot, numbers: dict[str, Any]) -> dict[str, Any]:
    """Returns what is measured and scored, by the sensors that are added."""
    model, data, legs, leg = robot.model, robot.data, bool(robot.feet), robot.leg
    axis, sign = robot.forward
    reached, leans, boxes = _target_sensor(robot), _tilt_axes(robot), [*robot.box.items()]
    goes = legs or (bool(robot.base) and reached is None)
    own = data.geom_xpos[robot.in_tree(model.geom_bodyid)]
    length = float(f"{np.ptp(own, axis=0).max(initial=0.0):.1g}" if own.size else 0.0) or 0.1
    speed = 0.5 * length if robot.kind == "swimmer" else 1.0  # half its length in a second [m/s]
    feet, steps, slips = list[str](), list[str](), list[str]()
    ground = ground_of(robot)
    when, still = "", list[str]()
    if robot.hops:  # it stands as it starts
        when, at = ", when: moving", model.jnt_qposadr
        places = {model.joint(j).name: data.qpos[at[j]] for j in robot.joints}
        still = [f"sensor: {j}/position, target: {_flow(q)}" for j, q in places.items()]
    for i, foot in enumerate(robot.feet):  # they swing in turn, at the clock's rhythm
        name = _flow(robot.new_sensor(f"foot_{i + 1}"))
        rest = data.geom_xpos[foot, 2]  # its height while it is down
        phase = 0.5 * (i % 2)
        swing = _flow({"swing": numbers["swing"], "phase": phase, "rest": rest})
        geom = _flow(model.geom(foot).name)
        feet.append(f"{name}: {{type: framepos, geom: {geom}}}")
        weight = _flow(numbers["stepping"])
        steps.append(f"{{sensor: {name}, index: z, target: {swing}, weight: {weight}{when}}}")
        # The middle of a whole shank moves while its end stands; what hops was not tried.
        if rest - ground > _LOW * leg or robot.hops:
            continue
        speed_of = _flow(robot.new_sensor(f"foot_{i + 1}_speed"))
        feet.append(f"{speed_of}: {{type: framelinvel, geom: {geom}}}")
        slip, along = _flow(numbers["slip"]), "[x, y]" if robot.is_free else axis
        stands = f"weight: {slip}, when: {{stance: {_flow(phase)}}}"
        slips.append(f"{{sensor: {speed_of}, index: {along}, {stands}}}")
    balls = [
        f"{_flow(robot.new_sensor(name + '_turn'))}: {_flow({'type': 'ballquat', 'joint': name})}"
        for name in _balls(robot)
    ]
    return {
        "root": _flow(robot.name),
        "goes": goes,
        "axis": axis,
        "speed": sign * speed,
        "per_speed": speed**-2,
        "rises": robot.height > 0.0,
        "height": ground + robot.height,
        "low": ground + _FALLEN * robot.height,
        "leans": ["xyz"[i] for i in leans],
        "upright": [robot.frame[2, i] for i in leans],
        "stands": robot.height > 0.0 and robot.frame[2, 2] > 0.9,
        "feet": feet,
        "steps": [*steps, *slips, *(f"{{{term}, weight: 5, when: still}}" for term in still)],
        "reached": reached,
        "ways": ([*robot.box] or _motion_axes(robot)) if reached else [],
        "pull": 4.0 / max(length, _target_distance(robot)) ** 2 if robot.base else 20,
        "told": [f"{axis}: {_flow({'range': box[1:], 'unit': 'm'})}" for axis, box in boxes],
        "places": [{"command": axis, "rest": box[0]} for axis, box in boxes],
        "nearness": 16.0 / boxes[0][1][2] ** 2 if boxes else 0.0,
        "turned": None if (turned := _hinge_to_turn(robot)) is None else model.joint(turned).name,
        "balls": balls,
        "axes": [
            f"{_flow(robot.new_sensor(f'{name}_axis'))}: {_flow(sensor)}"
            for name, (sensor, _) in _upright_axes(robot).items()
        ],
        "added": goes or reached or balls or leans or bool(_upright_axes(robot)),
        "pose": [] if robot.base else [_flow(term) for term in _pose_terms(robot)],
        "controls": [_flow(term) for term in _control_terms(robot)],
    }


def _first_motion_values(robot: Robot) -> dict[str, Any]:
    """Returns which first motion it gets, one of five."""
    controls = controls_of(robot.model) if robot.model.nu else None
    is_servo = controls is not None and set(controls.kinds) == {ControlKind.POSITION}
    path = robot.is_biped and not ((is_servo or controls is None) and _stands_held(robot))
    held = bool(robot.height) or (robot.kind in ("arm", "hand") and is_servo)
    held |= bool(robot.box) and len(robot.motors) == robot.model.nu
    high = controls.limits[1] if controls else np.full(1, np.inf)
    share = 0.7 if robot.kind == "swimmer" else 0.2
    std = np.where(np.isfinite(high) & (high > 0), share * high, 1.0).tolist()
    sampled = robot.hops and bool((np.isfinite(high) & (high > 0)).all())
    swings = _swings_up(robot)
    ends = _joint_goals(robot) if is_servo else {}
    return {
        "hops": robot.hops,
        "path": path,
        "sampled": sampled,
        "pd": held and not path and not sampled and not swings,
        "goal": ends or "",
        "noise": None if held or swings else std if len({*std}) > 1 else std[0],
        "swings": swings,
        "renews": swings or _has_target(robot),
        "while": 0.1 if robot.kind == "swimmer" else 0.3,
    }


def _stands_held(robot: Robot) -> bool:
    """Whether a robot with legs still stands after as long as DDP plans, if servos hold the start.

    Those are its own, or, if it has none, those that it shall get.
    """
    model, data = copy(robot.model), copy(robot.data)
    numbers = legged_numbers(robot)
    steps = round((numbers["horizon"] + numbers["lookahead"]) / model.opt.timestep)
    if model.nu:
        data.ctrl[:] = resting_controls(data)
        mujoco.mj_step(model, data, steps)
    else:
        places, dofs = model.jnt_qposadr[robot.joints], model.jnt_dofadr[robot.joints]
        limits, target = [_strength(robot, j) for j in robot.joints], data.qpos[places].copy()
        servos = [[*servo_numbers(robot, limit).values()] for limit in limits]
        stiffness, damping, armature = np.transpose(servos)
        model.dof_armature[dofs] += armature
        for _ in range(steps):
            torque = stiffness * (target - data.qpos[places]) - damping * data.qvel[dofs]
            data.qfrc_applied[dofs] = np.clip(torque, np.negative(limits), limits)
            mujoco.mj_step(model, data)
    fallen = data.xpos[robot.root, 2] - ground_of(robot) < _FALLEN * robot.height
    return not (ground_planes(robot).any() and fallen)


def _strength(robot: Robot, joint: int) -> float:
    """Returns a limit for a joint's motor [N·m]: what the model allows, or what its load asks."""
    model = robot.model
    known = (robot.strengths or {}).get(model.joint(joint).name, 0.0)
    if not known and model.jnt_actfrclimited[joint]:
        known = float(np.abs(model.jnt_actfrcrange[joint]).max())
    known = known or float(f"{_load(robot, joint):.3g}")
    return min(known, strongest(robot)) if robot.feet else known


def _load(robot: Robot, joint: int) -> float:
    """Returns the torque that moves and carries what hangs at a joint [N·m]."""
    model, data = robot.model, robot.data
    body, is_leg = int(model.jnt_bodyid[joint]), any(joint in leg for leg in legs_of(robot))
    far = float(np.linalg.norm(data.subtree_com[body] - data.xanchor[joint]))
    gyration = model.body_inertia[body].max() / max(model.body_mass[body], 1e-9)
    far = max(far, float(gyration) ** 0.5)  # of what is balanced on its joint
    carried = 0.5 * robot.mass * robot.leg
    load = max(3 * model.body_subtreemass[body] * far, carried if is_leg else 0.0)
    return float((robot.gravity or 9.81) * load)


def _mirror(robot: Robot) -> list[str]:
    """Returns the exchange of left and right, if places and axes of joints tell it, and names.

    Where along its axis a joint is anchored says nothing, but on which side of the robot it is.
    """
    model, data, joints = robot.model, robot.data, robot.joints
    if not robot.is_free or len(robot.feet) < 2 or robot.forward[0] != "x":
        return []
    anchors = (data.xanchor - data.xpos[robot.root]) @ robot.frame
    axes = data.xaxis @ robot.frame
    near = _ALIKE * robot.leg  # distance of two lines that are one
    motors = {joint: model.actuator(i).name for i, joint in robot.motors.items()}
    swaps, flips, pairs = set[tuple[str, str]](), list[str](), dict[str, str]()
    for j in joints:
        image = axes[j] * ([-1, 1, -1] if model.jnt_type[j] == HINGE else [1, -1, 1])
        aside = anchors[j] * [1, -1, 1] - anchors[joints]
        of_lines = np.linalg.norm(np.cross(aside, axes[joints]), axis=1)
        alike = (of_lines < near) & (np.abs(axes[joints] @ image) > 0.99)
        if not alike.any():
            return []
        k = joints[int(np.argmin(np.where(alike, np.linalg.norm(aside, axis=1), np.inf)))]
        for names in ({k: model.joint(k).name for k in joints}, motors):
            one, other = names.get(j, ""), names.get(k, "")
            pairs[one] = other
            parts = zip(*(re.split(r"([^A-Za-z]+)", n) for n in (one, other)), strict=False)
            swaps |= {(a, b) for a, b in parts if "" < a < b}
            flips += [one] if one and one not in flips and image @ axes[k] < 0 else []
    up, turning, velocity = (robot.new_sensor(name) for name in ("up", "turning", "velocity"))
    pairs |= {up: up, turning: turning}
    if any(swap_parts(a, sorted(swaps)) != b for a, b in pairs.items()):
        return []
    flips += [f"{velocity}/y"] if robot.is_biped else []
    flips += [f"{up}/y", f"{turning}/[xz]", "command/sideways", "command/turn", "clock/*"]
    return [f"swap: {_flow([list(pair) for pair in sorted(swaps)])}", f"flip: {_flow(flips)}"]


def _tilt_axes(robot: Robot) -> list[int]:
    """Returns the numbers of the vertical that change when the robot leans, such as x and y."""
    if not robot.base or not robot.gravity or (robot.kind == "swimmer" and not robot.is_free):
        return []
    hinges = [j for j in robot.base if robot.model.jnt_type[j] == HINGE]
    axes = np.eye(3) if robot.is_free else robot.model.jnt_axis[hinges]
    turning = np.abs(np.cross(axes, robot.frame[2])).max(axis=0, initial=0.0)
    return [int(i) for i in np.flatnonzero(turning > 1e-6)]


def _balls(robot: Robot) -> dict[str, list[float]]:
    """Returns the ball joints, with the quaternion of each at the start."""
    model = robot.model
    balls = np.flatnonzero(model.jnt_type == BALL)
    starts = {model.joint(j).name: robot.data.qpos[model.jnt_qposadr[j] :][:4] for j in balls}
    return {name: values.round(4).tolist() for name, values in starts.items()}


def _target(robot: Robot) -> tuple[str, str, Array] | None:
    """Returns what a model calls its target: the kind of thing, its name, and its place."""
    model, data = robot.model, robot.data
    of_kinds = {"geom": model.geom_bodyid, "site": model.site_bodyid, "body": range(model.nbody)}
    for kind, bodies in of_kinds.items():
        for i, body in enumerate(bodies):
            thing = getattr(data, kind)(i)
            if "target" in thing.name and (kind == "site" or not robot.in_tree(body)):
                return "xbody" if kind == "body" else kind, thing.name, np.array(thing.xpos)
    return None


def _target_sensor(robot: Robot) -> dict[str, Any] | None:
    """Returns the sensor of how far something is from the model's target, if it shall get there.

    That is an object beside an arm, or else its tip; and a swimmer, where the target is near. Of an
    arm that is commanded it is where its tip is.
    """
    if robot.box:
        return {"type": "framepos"} | _tip(robot)
    model, target, thing = robot.model, _target(robot), free_object_joint(robot)
    own = np.flatnonzero(robot.in_tree(model.geom_bodyid))
    if target is None or robot.kind not in ("arm", "hand", "swimmer") or not own.size:
        return None
    goal = {"relative_to": {target[0]: target[1]}}
    if robot.kind == "swimmer":
        size = np.ptp(robot.data.geom_xpos[own], axis=0).max() + model.geom_rbound[own].min()
        is_near = np.linalg.norm(target[2] - robot.data.xpos[robot.root]) < _NEAR * size
        seen = {"type": "framepos", target[0]: target[1], "relative_to": {"xbody": robot.name}}
        return seen if is_near else None  # in its own frame: where it has to turn
    if thing is None:
        return {"type": "framepos"} | _tip(robot) | goal
    is_turned, body = model.jnt_type[thing] == HINGE, model.body(model.jnt_bodyid[thing]).name
    return None if is_turned else {"type": "framepos", "xbody": body} | goal


def _tip(robot: Robot) -> dict[str, str]:
    """Returns the point of the last link that is farthest from its start: a site, or its geom."""
    model, data = robot.model, robot.data
    geom = int(np.flatnonzero(robot.in_tree(model.geom_bodyid))[-1])
    body = model.geom_bodyid[geom]
    sites = np.flatnonzero(model.site_bodyid == body)
    ways = np.linalg.norm(data.site_xpos[sites] - data.xpos[body], axis=1)
    if ways.max(initial=0.0) > np.linalg.norm(data.geom_xpos[geom] - data.xpos[body]):
        return {"site": model.site(int(sites[ways.argmax()])).name}
    return {"geom": model.geom(geom).name}


def _set_box(robot: Robot) -> None:
    """Sets the box in which an arm's tip follows commands, and starts the arm in its middle.

    That is where the model starts or, as of a straight arm, where its joints are bent; they keep to
    the inner two thirds of their ranges, and no more touches. An arm that is for something else has
    no box, nor one whose own motors cannot bring the tip to all its corners.
    """
    model, data = robot.model, copy(robot.data)
    is_for_more = _target(robot) or free_object_joint(robot) is not None or loops_of(model)
    if robot.kind != "arm" or is_for_more or not robot.in_tree(model.geom_bodyid).any():
        return
    kind, name = next(iter(_tip(robot).items()))
    tip, links = getattr(data, kind)(name), robot.chain(getattr(model, kind)(name).bodyid[0])
    joints = [j for j in robot.joints if model.jnt_bodyid[j] in links]
    if not joints or not {*model.jnt_dofadr[joints].tolist()} <= robot.driven:
        return
    from scipy.optimize import least_squares  # which is slow to load

    points, at = [*data.xanchor[joints], tip.xpos], model.jnt_qposadr[joints]
    robot.reach = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    low, high = np.where(model.jnt_limited[joints, None], model.jnt_range[joints], [-9, 9]).T

    def way(positions: Array, place: Array | float) -> Array:
        """Returns the way from a place to the tip [m]."""
        data.qpos[at] = positions
        mujoco.mj_kinematics(model, data)
        return tip.xpos - place

    inner = np.quantile([low, high], [1 / 6, 5 / 6], axis=0)
    bends = (robot.goal - data.qpos)[at] * np.array([[0], [1], [-1], [2], [-2], [3], [-3]])
    poses = np.clip(data.qpos[at] + bends, *inner)
    moved = np.ptp([way(pose, 0.0) for pose in poses], axis=0) > 1e-6
    for share, pose in product(_BOXES, poses):
        half, middle = float(f"{share * robot.reach:.2g}"), way(pose, 0.0)
        mujoco.mj_forward(model, data)
        if data.ncon > robot.data.ncon:
            continue
        corners = [middle + half * moved * signs for signs in product((-1, 1), repeat=3)]
        fits = [least_squares(way, pose, bounds=(low, high), args=(c,)) for c in corners]
        if np.abs([fit.fun for fit in fits]).max() < 0.02 * robot.reach:
            robot.box = {"xyz"[i]: [middle[i], -half, half] for i in np.flatnonzero(moved)}
            data.qpos[at] = pose
            mujoco.mj_forward(model, data)
            robot.data, robot.goal, robot.strengths = data, data.qpos.copy(), robot.strengths or {}
            return


def _has_target(robot: Robot) -> bool:
    """Returns whether it swims to a target, from wherever it is."""
    return bool(robot.base) and _target_sensor(robot) is not None


def _start_spread(robot: Robot) -> dict[str, Any]:
    """Returns how the starts differ from which a swimmer or an arm learns to get to its target."""
    if robot.box:
        slides = [robot.model.joint(j).name for j in robot.joints if j not in robot.hinges]
        still = {"overrides": {f"{name}/position": 0.01 for name in slides}} if slides else {}
        return {"position": 0.4, "velocity": 0.3} | still
    spread, half = dict[str, float](), _target_distance(robot) / 2
    for name, kind in ((robot.model.joint(j).name, robot.model.jnt_type[j]) for j in robot.base):
        if robot.is_free:
            spread |= {f"{name}/[xyz]": half, f"{name}/r?": 1.0}
        else:
            spread[f"{name}/position"] = 1.0 if kind == HINGE else half
    return {"position": 0.2, "velocity": 0.1, "overrides": spread}


def _target_distance(robot: Robot) -> float:
    """Returns how far its target is, or 1 without one [m]."""
    target = _target(robot)
    return float(np.linalg.norm(target[2] - robot.data.xpos[robot.root])) if target else 1.0


def _carries_object(robot: Robot) -> bool:
    """Returns whether it brings a thing that falls to the target."""
    return (
        bool(robot.gravity)
        and _target_sensor(robot) is not None
        and free_object_joint(robot) is not None
    )


def _swings_up(robot: Robot) -> bool:
    """Returns whether it swings itself, or a thing beside it that it catches or turns."""
    return robot.kind == "pendulum" or _carries_object(robot) or _hinge_to_turn(robot) is not None


def _hinge_to_turn(robot: Robot) -> int | None:
    """Returns the hinge of a thing beside it, which it shall turn, since only touch moves it."""
    model, thing = robot.model, free_object_joint(robot)
    if thing is None or model.jnt_type[thing] != HINGE:
        return None
    own = model.geom_bodyid == model.jnt_bodyid[thing]
    is_touched = bool((own & touching_geoms(model)).any())
    return thing if is_touched and not robot.base and _target_sensor(robot) is None else None


def _contact_time(robot: Robot) -> float:
    """Returns a time constant of contact that can be differentiated [s].

    What lies on something sinks in by g τ², which may be a tenth of the size of a thing that is to
    be caught, or of the height of a robot.
    """
    model, thing = robot.model, free_object_joint(robot)
    size = robot.height or np.inf
    if thing is not None and _carries_object(robot):
        own = (model.geom_bodyid == model.jnt_bodyid[thing]) & touching_geoms(model)
        size = float(model.geom_size[own, 0].min(initial=np.inf))
    least = 2.0 * model.opt.timestep  # below which MuJoCo's contact is unstable
    return float(np.clip(np.sqrt(0.1 * size / (robot.gravity or 9.81)), min(least, 0.04), 0.04))


def _motion_axes(robot: Robot) -> list[str]:
    """Returns the axes along which anything that joints carry can move, as all but y in a plane."""
    model, data = robot.model, mujoco.MjData(robot.model)
    rng, places = np.random.default_rng(0), []
    for _ in range(3):
        mujoco.mj_integratePos(model, data.qpos, rng.standard_normal(model.nv), 0.3)
        mujoco.mj_kinematics(model, data)
        places.append(data.geom_xpos[model.body_weldid[model.geom_bodyid] > 0].copy())
    return ["xyz"[i] for i in np.flatnonzero(np.ptp(places, axis=0).max(axis=0) > 1e-6)]


def _endless_hinges(robot: Robot) -> list[int]:
    """Returns the hinges of a pendulum that turn without end, so that sine and cosine count."""
    is_one = robot.kind == "pendulum"
    return [j for j in robot.hinges if is_one and not robot.model.jnt_limited[j]]


def _upright_axes(robot: Robot) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Returns what of a pendulum's links shall stand, by the hinge of each: sensor and cost.

    The sensor is of an axis of the link, and the cost's weight its share of what is lifted.
    A link's direction in the world counts, not the angle of its hinge: so a link at the end of
    others may swing as they need it, and each counts as much as gravity does about its hinge.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.goal
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    found = dict[int, tuple[str, Array, float]]()
    turning = _endless_hinges(robot)
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
        model.joint(j).name: (
            {"type": f"frame{axis}axis", "xbody": model.body(model.jnt_bodyid[j]).name},
            {"target": target.tolist(), "weight": float(f"{size / total:.3f}")},
        )
        for j, (axis, target, size) in found.items()
    }


def _pose_terms(robot: Robot) -> list[dict[str, Any]]:
    """Returns the cost of a robot that stays in its place: its goal, and rest there.

    What it shall do to a thing beside it is not known. As a guess it turns a hinge, and a hand
    what it holds.
    """
    model, terms, thing = robot.model, list[dict[str, Any]](), free_object_joint(robot)
    has_target, is_pendulum = _target_sensor(robot) is not None, robot.kind == "pendulum"
    turns = (HINGE,) if robot.kind != "hand" else (HINGE, FREE, BALL)
    is_turned = thing is not None and model.jnt_type[thing] in turns and not has_target
    turning, upright = _endless_hinges(robot), _upright_axes(robot)
    for name, (_, stands) in upright.items():
        terms.append({"sensor": robot.new_sensor(f"{name}_axis")} | stands)
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
        terms.append({"sensor": robot.new_sensor(name + "_turn"), "target": turn})
        terms += [{"sensor": rate, "weight": 0.1} for rate in _rates(name)]
    if is_turned:
        rate = "velocity" if model.jnt_type[thing] == HINGE else "wz"
        terms.append({"sensor": f"{model.joint(thing).name}/{rate}", "target": 3.0})
    return terms


def _joint_goals(robot: Robot) -> dict[str, float]:
    """Returns where the joints shall go that are scored by their positions."""
    terms = [] if robot.base else _pose_terms(robot)
    sought = {term["sensor"].partition("/position"): term.get("target", 0.0) for term in terms}
    return {name: goal for (name, part, _), goal in sought.items() if part}


def _control_terms(robot: Robot) -> list[dict[str, Any]]:
    """Returns the cost of controls: each weighs the same at its own limit, of a servo its force.

    Of one that acts late what it brings about is scored, not how far it leads.
    """
    model = robot.model
    strong = 3.0 if robot.feet else 0.5  # what a control at its limit costs in each step
    if robot.kind == "swimmer":  # all of whose controls have to work as long as it goes
        strong = 0.1 / max(1, model.nu)
    elif robot.kind == "pendulum" and weak_motors(robot):  # which must use all their force
        strong = 0.2
    if not model.nu:
        is_held = robot.feet or robot.box
        stiff = {"pose": "start", "weight": strong} if is_held else {"weight": strong / 400}
        return [{"control": "all"} | stiff]
    controls, groups = controls_of(model), dict[tuple[bool, str], list[str]]()
    there = mujoco.MjData(model)
    there.qpos[:] = robot.goal
    mujoco.mj_forward(model, there)
    ways = np.abs(resting_controls(there) - resting_controls(robot.data))
    pose = _joint_goals(robot) or "start"
    for i, (kind, high) in enumerate(zip(controls.kinds, controls.limits[1], strict=True)):
        is_servo = kind is ControlKind.POSITION
        limit = high if np.isfinite(high) and high > 0 else 10.0
        if is_servo:
            limit = max(_working_reach(robot, controls, i), ways[i], bool(robot.box))
            if not robot.feet:  # whose servos may weigh little, and get near their goal at once
                limit = min(limit, np.ptp(controls.limits, axis=0)[i] / 2)
        weight = f"{strong / limit**2 / _lag_gains(robot)[i]:.2g}"
        groups.setdefault((is_servo, weight), []).append(model.actuator(i).name)
    return [
        {"control": "all" if len(groups) == 1 else names}
        | ({"pose": pose} if is_servo else {})
        | {"weight": float(weight)}
        for (is_servo, weight), names in groups.items()
    ]


def _working_reach(robot: Robot, controls: Controls, i: int) -> float:
    """Returns by how much a servo's control differs from its pose where it works hard.

    A control there costs as much as a motor at its limit. It is where the servo's force is
    greatest; a hinge of a robot with legs gets at least what a step takes.
    """
    model, stiffness = robot.model, controls.stiffness[i]
    joint, force = int(model.actuator_trnid[i, 0]), controls.servo_forces[i]
    reach = force / stiffness if force < 1e6 else _UNKNOWN_REACH
    if not robot.feet:
        reach = min(reach, 1.0)
    elif model.actuator_trntype[i] == _AT_JOINT and model.jnt_type[joint] == HINGE:
        damping = controls.damping[i] + float(model.dof_damping[model.jnt_dofadr[joint]])
        reach = max(reach, servo_reach(robot, stiffness, damping, _load(robot, joint)))
    return float(reach / abs(controls.scale[i]))


def _observations(robot: Robot) -> list[Any]:
    model, entries = robot.model, list[Any]()
    endless = [j for j in (_hinge_to_turn(robot),) if j is not None and not model.jnt_limited[j]]
    turning = [model.joint(j).name for j in [*_endless_hinges(robot), *endless]]
    cyclic = {name.rpartition("/")[0] for name in robot.cyclic_places()}
    out = [name for name in joint_names(model) if name in cyclic or name in turning]
    carried = [model.joint(j).name for j in robot.base if model.jnt_type[j] >= SLIDE]
    unread = carried if (seeks := _has_target(robot)) else []  # it sees where the target is
    for kind, names in (("positions", unread or out), ("velocities", unread)):
        if len(names) < len(joint_names(model)):
            key = f"joint_{kind}"
            entries.append({key: {"except": names}} if names else key)
    if seeks:
        return [
            *entries,
            *(robot.new_sensor(name) for name in ("velocity", "turning", "to_target")),
        ]
    entries += [{"joint": name, "as": "sin_cos"} for name in turning]
    entries += [robot.new_sensor("up")] if robot.is_free and _tilt_axes(robot) else []
    if robot.is_free and robot.feet:
        entries.append(robot.new_sensor("turning"))
        entries += [robot.new_sensor("velocity")] if robot.is_biped else []
    elif robot.is_free:
        joint = model.joint(robot.base[0]).name
        entries += [*(f"{joint}/{rate}" for rate in ("z", "vx", "vy", "vz")), *_rates(joint)]
    for name in _balls(robot):
        entries += [robot.new_sensor(name + "_turn"), *_rates(name)]
    seen = "tip" if robot.box else "to_target"
    entries += [robot.new_sensor(seen)] if _target_sensor(robot) else []
    lagging = (model.actuator(int(i)).name for i in np.flatnonzero(model.actuator_actnum == 1))
    entries += [f"{name}/activation" for name in lagging]
    entries += ["commands", "clock"] if robot.feet else ["commands"] if robot.box else []
    return entries


def _rates(joint: str) -> list[str]:
    return [f"{joint}/{rate}" for rate in ("wx", "wy", "wz")]
