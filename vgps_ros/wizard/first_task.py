# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a first task file for a robot, with comments that say what to change.

What it does not know, the file says. Here are the facts about the robot that a task needs; what the
robot is for is found in `recognition`, and the lines that the facts pick and fill stand in
`first_task.template`.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from string import Template
from typing import Any

import mujoco
import numpy as np

from vgps_ros.robot.controls import CONTROL_BOUND, ControlKind
from vgps_ros.simulation.controls import controls_of, resting_controls
from vgps_ros.simulation.model import joint_names
from vgps_ros.wizard import targets
from vgps_ros.wizard.legged_scale import legged_numbers, servo_numbers
from vgps_ros.wizard.legs import FALLEN, command_values, foot_contacts, foot_terms, stands_held
from vgps_ros.wizard.model_edits import EditedModel, has_motors_too_strong
from vgps_ros.wizard.motors import lag_gains, motor_strength, working_reach
from vgps_ros.wizard.recognition import recognise_robot
from vgps_ros.wizard.robot import (
    BALL,
    FREE,
    HINGE,
    SLIDE,
    Robot,
    finger_count,
    free_object_joint,
    ground_of,
    touching_geoms,
    weak_motors,
)
from vgps_ros.wizard.swings import (
    endless_hinges,
    hinge_to_turn,
    swing_time,
    swings_up,
    upright_axes,
)

_TEMPLATE = Path(__file__).with_name("first_task.template")
_SENSORS = ("velocity", "turning", "height", "up", "to_target", "tip")  # whose names may be taken
_PERIOD = 0.02  # of control, of what swims or swings [s]
_AT_JOINT = mujoco.mjtTrn.mjTRN_JOINT
_IMPLICIT = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
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
    targets.set_box(robot)
    facts: dict[str, Any] = dict.fromkeys(_EDITS) | changes
    facts |= _template_values(robot, former) | {"schema": schema, "model": reference}
    facts["locks"] = changes.get("joints", {})
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
            lines += [filled + entry for entry in _entries(facts[each])] if each else [filled]
    return "\n".join(lines) + "\n"


def _entries(values: dict[str, Any] | list[Any]) -> list[str]:
    """Returns each entry of a mapping or of a list, as YAML has it on a line of its own."""
    if isinstance(values, dict):
        return [_flow({name: value})[1:-1] for name, value in values.items()]
    return [*map(_flow, values)]


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
        "goes_on": bool(robot.base or robot.box) or swings_up(robot),
        "keyframe": None if robot.key is None else listed["keyframes"][robot.key],
        "moved": _flow(moved, 5) if moved else "",
        "seeks": (seeks := targets.has_target(robot)),
        "measured": seeks or (legs and robot.is_free),
        "swims": "reach what is called target" if seeks else f"go along {robot.forward[0]}",
        "varied": targets.start_spread(robot) if seeks or robot.box else None,
        "observed": _observations(robot),
        **{name.upper(): _flow(robot.new_sensor(name)) for name in _SENSORS},
        **numbers,
        **{time: f"{numbers[time]:g}" for time in ("step", "period", "horizon", "lookahead")},
        **_model_changes(robot, numbers),
        **_cost_values(robot, numbers),
        **_first_motion_values(robot),
        **(command_values(robot) if legs else {}),
    }


def _general_numbers(robot: Robot) -> dict[str, Any]:
    """Returns the times and the spread of a robot without legs."""
    step, is_swimmer = robot.model.opt.timestep, robot.kind == "swimmer"
    period = _whole(_PERIOD if is_swimmer or robot.kind == "pendulum" else 0.01, step)
    planned = swing_time(robot) if robot.kind == "pendulum" else 2.0
    if robot.box:
        planned = 3.0 * float((robot.reach / (robot.gravity or 9.81)) ** 0.5)
        period = _whole(planned / 50, step)
    swings = 0.75 * planned if swings_up(robot) else 0.0  # a plan's end needs no feedback
    horizon = _whole(3.0 if is_swimmer else swings or planned, period)
    same = [] if targets.has_target(robot) else robot.cyclic_places()
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
    """Returns the template's facts about changes of the model."""
    model, option, step = robot.model, robot.model.opt, numbers["step"]
    touches = bool(not option.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT)
    touches &= bool(touching_geoms(model).any())
    is_round = touches and option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    wanted = {  # where the model's own will not do
        "timestep": (step, option.timestep == step),
        "integrator": ("implicitfast", option.integrator == _IMPLICIT),
        "solver": ("Newton", option.solver == mujoco.mjtSolver.mjSOL_NEWTON),
        "iterations": (100, option.iterations >= 50),
        "ls_iterations": (50, option.ls_iterations >= 20),
        "tolerance": (1e-10, option.tolerance <= 1e-10),
        "cone": ("pyramidal", not is_round),
    }
    options = {name: value for name, (value, has) in wanted.items() if not has}
    groups = dict[float, list[str]]()
    for j in [] if model.nu else robot.joints:
        groups.setdefault(motor_strength(robot, j), []).append(model.joint(j).name)
    motors = dict[str, Any]()
    for limit, names in groups.items():
        motor: dict[str, Any] = {"joint": names if len(names) > 1 else names[0]}
        if robot.feet or robot.strengths is not None:  # damped as a gear damps
            motor |= servo_numbers(robot, limit)
        key = f"up_to_{limit:g}" if len(names) > 1 else names[0]
        motors[key] = motor | {"limit": limit}
    return {
        "options": _flow(options, 6) if options else "",
        "contact": touches,
        "limits": (model.jnt_limited.astype(bool) & (model.jnt_solimp[:, 0] > 0.0)).any(),
        "motors": motors,
        "servos": bool(robot.feet) or robot.strengths is not None,
        "only": foot_contacts(robot) if touches else None,
    }


def _cost_values(robot: Robot, numbers: dict[str, Any]) -> dict[str, Any]:
    """Returns the template's facts about the cost, and the sensors that it adds."""
    model, ground, (axis, sign) = robot.model, ground_of(robot), robot.forward
    target, leans, upright = targets.target_values(robot), _tilt_axes(robot), upright_axes(robot)
    goes = bool(robot.feet) or (bool(robot.base) and target["reached"] is None)
    own = robot.data.geom_xpos[robot.in_tree(model.geom_bodyid)]
    length = float(f"{np.ptp(own, axis=0).max(initial=0.0):.1g}" if own.size else 0.0) or 0.1
    speed = 0.5 * length if robot.kind == "swimmer" else 1.0  # half its length in a second [m/s]
    feet, steps = foot_terms(robot, numbers)
    balls = {
        robot.new_sensor(f"{name}_turn"): {"type": "ballquat", "joint": name}
        for name in _balls(robot)
    }
    axes = {robot.new_sensor(f"{name}_axis"): sensor for name, (sensor, _) in upright.items()}
    return {
        **target,
        "root": _flow(robot.name),
        "goes": goes,
        "axis": axis,
        "speed": sign * speed,
        "per_speed": speed**-2,
        "rises": robot.height > 0.0,
        "height": ground + robot.height,
        "low": ground + FALLEN * robot.height,
        "leans": ["xyz"[i] for i in leans],
        "upright": [robot.frame[2, i] for i in leans],
        "stands": robot.height > 0.0 and robot.frame[2, 2] > 0.9,
        "feet": feet,
        "steps": steps,
        "pull": 4.0 / max(length, targets.target_distance(robot)) ** 2 if robot.base else 20,
        "turned": None if (turned := hinge_to_turn(robot)) is None else model.joint(turned).name,
        "balls": balls,
        "axes": axes,
        "added": goes or target["reached"] or balls or leans or axes,
        "pose": [] if robot.base else _pose_terms(robot),
        "controls": _control_terms(robot),
    }


def _first_motion_values(robot: Robot) -> dict[str, Any]:
    """Returns the template's facts about the first motion, which is one of five."""
    controls = controls_of(robot.model) if robot.model.nu else None
    is_servo = controls is not None and set(controls.kinds) == {ControlKind.POSITION}
    path = robot.is_biped and not ((is_servo or controls is None) and stands_held(robot))
    held = bool(robot.height) or (robot.kind in ("arm", "hand") and is_servo)
    held |= bool(robot.box) and len(robot.motors) == robot.model.nu
    high = controls.limits[1] if controls else np.full(1, np.inf)
    share = 0.7 if robot.kind == "swimmer" else 0.2
    std = np.where(np.isfinite(high) & (high > 0), share * high, 1.0).tolist()
    sampled = robot.hops and bool((np.isfinite(high) & (high > 0)).all())
    swings = swings_up(robot)
    ends = _joint_goals(robot) if is_servo else {}
    return {
        "hops": robot.hops,
        "path": path,
        "sampled": sampled,
        "pd": held and not path and not sampled and not swings,
        "goal": ends or "",
        "noise": None if held or swings else std if len({*std}) > 1 else std[0],
        "swings": swings,
        "renews": swings or targets.has_target(robot),
        "while": 0.1 if robot.kind == "swimmer" else 0.3,
    }


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


def _contact_time(robot: Robot) -> float:
    """Returns a time constant of contact that can be differentiated [s].

    What lies on something sinks in by g τ², which may be a tenth of the size of a thing that is to
    be caught, or of the height of a robot.
    """
    model, thing = robot.model, free_object_joint(robot)
    size = robot.height or np.inf
    if thing is not None and targets.carries_object(robot):
        own = (model.geom_bodyid == model.jnt_bodyid[thing]) & touching_geoms(model)
        size = float(model.geom_size[own, 0].min(initial=np.inf))
    least = 2.0 * model.opt.timestep  # below which MuJoCo's contact is unstable
    return float(np.clip(np.sqrt(0.1 * size / (robot.gravity or 9.81)), min(least, 0.04), 0.04))


def _pose_terms(robot: Robot) -> list[dict[str, Any]]:
    """Returns the cost of a robot that stays in its place: its goal, and rest there.

    What it shall do to a thing beside it is not known. As a guess it turns a hinge, and a hand
    what it holds.
    """
    model, terms, thing = robot.model, list[dict[str, Any]](), free_object_joint(robot)
    is_sent, is_pendulum = (targets.target_sensor(robot) is not None, robot.kind == "pendulum")
    turns = (HINGE,) if robot.kind != "hand" else (HINGE, FREE, BALL)
    is_turned = thing is not None and model.jnt_type[thing] in turns and not is_sent
    turning, upright = endless_hinges(robot), upright_axes(robot)
    for name, (_, stands) in upright.items():
        terms.append({"sensor": robot.new_sensor(f"{name}_axis")} | stands)
    for j in robot.joints:
        name, goal = model.joint(j).name, robot.goal[model.jnt_qposadr[j]]
        if j in turning:
            for wave, to in (("cos", np.cos(goal)), ("sin", np.sin(goal))):
                term = {"sensor": f"{name}/{wave}", "target": round(float(to), 3)}
                terms += [] if name in upright else [term | {"weight": 0.1}]
        elif not (is_sent or is_turned):
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
            limit = max(working_reach(robot, controls, i), ways[i], bool(robot.box))
            if not robot.feet:  # whose servos may weigh little, and get near their goal at once
                limit = min(limit, np.ptp(controls.limits, axis=0)[i] / 2)
        weight = f"{strong / limit**2 / lag_gains(robot)[i]:.2g}"
        groups.setdefault((is_servo, weight), []).append(model.actuator(i).name)
    return [
        {"control": "all" if len(groups) == 1 else names}
        | ({"pose": pose} if is_servo else {})
        | {"weight": float(weight)}
        for (is_servo, weight), names in groups.items()
    ]


def _observations(robot: Robot) -> list[Any]:
    model, entries = robot.model, list[Any]()
    endless = [j for j in (hinge_to_turn(robot),) if j is not None and not model.jnt_limited[j]]
    turning = [model.joint(j).name for j in [*endless_hinges(robot), *endless]]
    cyclic = {name.rpartition("/")[0] for name in robot.cyclic_places()}
    out = [name for name in joint_names(model) if name in cyclic or name in turning]
    carried = [model.joint(j).name for j in robot.base if model.jnt_type[j] >= SLIDE]
    unread = carried if (seeks := targets.has_target(robot)) else []  # it sees where the target is
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
    entries += [robot.new_sensor(seen)] if targets.target_sensor(robot) else []
    lagging = (model.actuator(int(i)).name for i in np.flatnonzero(model.actuator_actnum == 1))
    entries += [f"{name}/activation" for name in lagging]
    entries += ["commands", "clock"] if robot.feet else ["commands"] if robot.box else []
    return entries


def _rates(joint: str) -> list[str]:
    return [f"{joint}/{rate}" for rate in ("wx", "wy", "wz")]
