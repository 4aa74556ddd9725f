# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy of ours as others deploy theirs: for Unitree, a LEAPP bundle, and for the Microduck.

They know terms where our policies read numbers: the positions of all joints, the velocity of the
base in its axes. A number of ours is one of a term where both agree in several states. A network
for them begins by picking its numbers out of the terms.
"""

import fnmatch
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.memory import LAST_ACTION, terms_of
from vgps_ros.core.records import Array
from vgps_ros.policies.contract import VELOCITY_COMMANDS, Contract
from vgps_ros.policies.driver import observation_of
from vgps_ros.policies.onnx_file import (
    OPSET,
    Builder,
    ExportedPolicy,
    model_of,
    network,
    with_commas,
)
from vgps_ros.robot.controls import ControlKind
from vgps_ros.robot.unrest import RATE, TILT
from vgps_ros.simulation.model import state_names
from vgps_ros.simulation.readings import Readings
from vgps_ros.storage.files import replacing
from vgps_ros.storage.software import commit
from vgps_ros.tasks.task import Task
from vgps_ros.tasks.task_file import read_task_file

_BASE = ("base_lin_vel", "base_ang_vel", "projected_gravity")
_RANGES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")  # of VELOCITY_COMMANDS, as others call them
_UNITREES = {  # terms that its controller knows, in the order in which they are written
    "base_ang_vel": "base_ang_vel",
    "projected_gravity": "projected_gravity",
    "velocity_commands": "velocity_commands",
    "joint_pos": "joint_pos_rel",
    "joint_vel": "joint_vel_rel",
    "last_action": "last_action",
    "gait_phase": "gait_phase",
}
_DOUBLE = 11  # ONNX's number of float64
_STATES = 4  # in which numbers are compared
_SAME = 1e-9


@dataclass(frozen=True)
class _Number:
    """A number that a policy reads: ± a number of a term.

    Attributes:
        name: its own name.
        term: the term, of `policies.contract`; empty: there is none.
        index: its place in the term.
        sign: 1 or -1.
        lag: how many steps ago it was read.
    """

    name: str
    term: str = ""
    index: int = 0
    sign: float = 1.0
    lag: int = 0


def _numbers_of_terms(task: Task, observed: tuple[str, ...]) -> list[_Number]:
    """Returns what a policy of the task reads, by the terms of the field."""
    terms = terms_of(observed)
    read = {name for name, _ in terms} - {LAST_ACTION, *task.signals.names}
    known = _context_terms(task, sorted(read))
    acting = [
        _Number(f"{LAST_ACTION}/{i}", LAST_ACTION, i) for i in range(len(task.controls.names))
    ]
    found = list[_Number]()
    for name, lag in terms:
        term, index, sign = known.get(name, ("", 0, 1.0))
        found += acting if name == LAST_ACTION else [_Number(name, term, index, sign, lag)]
    return found


def _context_terms(task: Task, names: list[str]) -> dict[str, tuple[str, int, float]]:
    """Returns term, index and sign of readings, commands and clock, where there are any."""
    signals, joints = task.signals, task.controls.names
    found = {f"clock/{each}": ("gait_phase", i, 1.0) for i, each in enumerate(("sin", "cos"))}
    for command in signals.commands:
        if command.source in VELOCITY_COMMANDS:
            place = VELOCITY_COMMANDS.index(command.source)
            found[f"command/{command.name}"] = ("velocity_commands", place, 1.0)
    space, simulations = task.observation.space, task.dynamics.simulations
    waves = np.outer(1 + np.arange(_STATES), 1 + np.arange(space.tangent_dim))
    states = space.add(np.tile(task.initial_state, (_STATES, 1)), 0.3 * np.sin(waves))
    values, candidates = Readings(simulations, names)(states), dict[tuple[str, int], Array]()
    coordinates = state_names(simulations.model)
    for term, kind in (("joint_pos", "position"), ("joint_vel", "velocity")):
        for i, joint in enumerate(joints):
            if (coordinate := f"{joint}/{kind}") in coordinates:
                candidates[term, i] = states[:, coordinates.index(coordinate)]
    if (simulations.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any():
        said = {"joint_names": with_commas(joints), "observation_names": with_commas(_BASE)}
        contract = Contract(said, "The robot")
        robot = task.deployment
        read = observation_of(contract, robot.layout, robot.read, signals, "The robot")(states)
        frames = contract.remembered(read, None).frames[:, -1]
        candidates |= {(_BASE[i // 3], i % 3): frames[:, i] for i in range(frames.shape[1])}
    for name, value in zip(names, values.T, strict=True):
        for (term, i), candidate in candidates.items():
            for sign in (1.0, -1.0):
                if np.allclose(value, sign * candidate, rtol=0.0, atol=_SAME):
                    found.setdefault(name, (term, i, sign))
    return found


def _fitting_numbers(
    task: Task, exported: ExportedPolicy, taker: str, terms: tuple[str, ...]
) -> list[_Number]:
    """Returns what a policy of servos reads, all of which is of terms of `_UNITREES`.

    Raises:
        InvalidInputError: it is not; the sentence says what takes which terms.
    """
    for name, kind in zip(task.controls.names, task.controls.kinds, strict=True):
        if kind is not ControlKind.POSITION:
            raise InvalidInputError(
                f"The control of {name} is a {kind}, but {taker} has targets of positions alone; "
                "use a robot of servos, or a LEAPP bundle."
            )
    numbers = _numbers_of_terms(task, exported.policy.observed)
    for number in numbers:
        if number.term not in _UNITREES:
            raise InvalidInputError(
                f"The policy reads {quote(number.name)}, which is none of {taker}'s terms "
                f"{', '.join(terms)}; observe these alone, or use a LEAPP bundle."
            )
    return numbers


def write_unitrees(task: Task, exported: ExportedPolicy, folder: Path) -> None:
    """Writes params/deploy.yaml and exported/policy.onnx, as unitree_rl_lab has them.

    Raises:
        InvalidInputError: the policy reads or gives what a deploy.yaml cannot say.
    """
    controls, signals = task.controls, task.signals
    numbers = _fitting_numbers(task, exported, "a deploy.yaml", tuple(_UNITREES.values()))
    n_u, origin = len(controls.names), controls.at_joints(np.array(exported.origin))
    sizes = {**dict.fromkeys(_UNITREES, 3), "gait_phase": 2}
    sizes |= dict.fromkeys(("joint_pos", "joint_vel", "last_action"), n_u)
    steps = {
        term: 1 + max(number.lag for number in numbers if number.term == term)
        for term in _UNITREES
        if any(number.term == term for number in numbers)
    }
    first, end = dict[str, int](), 0
    for term, count in steps.items():
        first[term], end = end, end + count * sizes[term]
    places = [
        first[n.term] + (steps[n.term] - 1 - n.lag) * sizes[n.term] + n.index for n in numbers
    ]
    offsets = [origin[n.index] * (n.term == "joint_pos") for n in numbers]
    build = Builder("float32")
    read = build.node("Cast", "obs", to=_DOUBLE)
    signs = [number.sign for number in numbers]
    actions, _ = network(exported, build, _pick_inputs(build, read, places, offsets, signs))
    build.give(actions, "actions")
    graph = build.graph([build.declared("obs", 1, end)], [build.declared("actions", 1, n_u)])
    ranges: dict[str, Any] = {key: [0.0, 0.0] for key in _RANGES}
    for command in signals.commands:
        if command.source in VELOCITY_COMMANDS:
            name = _RANGES[VELOCITY_COMMANDS.index(command.source)]
            ranges[name] = [float(command.lowest), float(command.highest)]
    observations = {
        _UNITREES[term]: {
            "params": {"period": signals.period} if term == "gait_phase" else {},
            "clip": None,
            "scale": [1.0] * sizes[term],
            "history_length": count,
        }
        for term, count in steps.items()
    }
    action = {"clip": None, "joint_names": [".*"], "scale": controls.scale.tolist()}
    said = {
        "joint_ids_map": [*range(n_u)],
        "step_dt": task.dynamics.time_step,
        "stiffness": controls.stiffness.tolist(),
        "damping": controls.damping.tolist(),
        "default_joint_pos": origin.tolist(),
        "commands": {"base_velocity": {"ranges": {**ranges, "heading": None}}},
        "actions": {
            "JointPositionAction": {**action, "offset": origin.tolist(), "joint_ids": None}
        },
        "observations": observations,
    }
    _write(folder / "exported" / "policy.onnx", model_of(graph, {}))
    _write(folder / "params" / "deploy.yaml", _yaml(said))


# LEAPP's kind of what a control is at its joint; of an activation there is none.
_LEAPPS = {
    ControlKind.POSITION: "target/joint/position",
    ControlKind.VELOCITY: "target/joint/velocity",
    ControlKind.TORQUE: "target/joint/effort",
    ControlKind.FORCE: "target/joint/effort",
}
# Gravity's direction in a frame whose quaternion is q = (x, y, z, w), of length 1, is qᵀ M q, with
# a matrix M for each axis; here [i, axis, j].
_GRAVITY = np.array(
    [
        [[0, 0, -2, 0], [0, 0, 0, 0], [1, 0, 0, 0]],
        [[0, 0, 0, 0], [0, 0, -2, 0], [0, 1, 0, 0]],
        [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, -1, 0]],
        [[0, 2, 0, 0], [-2, 0, 0, 0], [0, 0, 0, -1]],
    ]
)


def write_leapp(task: Task, exported: ExportedPolicy, folder: Path) -> None:
    """Writes a LEAPP bundle: policy.yaml, policy.onnx and what its states begin with.

    Its inputs are what a robot measures; the clock is a state of the network, and so are the steps
    for which one that stops goes on (`robot.unrest`), and the last action. A reading that is no
    term is an input of its own, without a kind.

    Raises:
        InvalidInputError: the policy reads former steps, of which no state tells in the first one.
    """
    controls, signals, names = task.controls, task.signals, task.controls.names
    numbers = _numbers_of_terms(task, exported.policy.observed)
    if past := next((n.name for n in numbers if n.lag), ""):
        raise InvalidInputError(
            f"The policy reads {quote(past)} of former steps, which equal the first one in the "
            "first step; no state of a LEAPP bundle does: use the ONNX file or a deploy.yaml."
        )
    build = Builder("float32")
    inputs, outputs = list[dict[str, Any]](), list[dict[str, Any]]()
    parts, first, end = list[str](), dict[str, int](), 0
    tensors = {
        "joint_pos": ("state/joint/position", names),
        "joint_vel": ("state/joint/velocity", names),
        "base_lin_vel": ("state/body/linear_velocity", tuple("xyz")),
        "base_ang_vel": ("state/body/angular_velocity", tuple("xyz")),
        "projected_gravity": ("state/body/rotation", ("qx", "qy", "qz", "qw")),
        "velocity_commands": ("command/body/velocity", _RANGES),
        "last_action": ("", names),
        "gait_phase": ("", ("phase",)),
        "awake": ("", ("steps",)),
        "": ("", tuple(n.name for n in numbers if not n.term)),
    }
    feedback, states = dict[str, list[str]](), dict[str, Array]()
    read_terms, parts_of = {number.term for number in numbers}, dict[str, str]()
    stops = "gait_phase" in read_terms and task.unrest
    if stops:
        read_terms |= {"base_ang_vel", "projected_gravity", "awake"}
    for term, (kind, elements) in tensors.items():
        if term not in read_terms:
            continue
        name = {"projected_gravity": "base_rotation", "": "readings"}.get(term, term)
        is_clock, is_state = term == "gait_phase", term in ("gait_phase", "last_action", "awake")
        name += "_in" * is_state
        inputs.append(_tensor(name, kind, elements, "float64" if is_clock else "float32"))
        value = build.node("Cast", name, to=_DOUBLE)
        if is_state:
            feedback[f"policy/{term}_out"] = [f"policy/{name}"]
            states[f"policy/{name}"] = np.zeros((1, len(elements)))
        if is_clock:
            value = _clock(build, value, signals.frequency * task.dynamics.time_step)
        elif term == "projected_gravity":
            value = _gravity(build, value)
        parts_of[term] = value
        parts.append(value)
        first[term], end = (
            end,
            end + {"projected_gravity": 3, "gait_phase": 2}.get(term, len(elements)),
        )
    loose = {n.name: i for i, n in enumerate(n for n in numbers if not n.term)}
    places = [first[n.term] + loose.get(n.name, n.index) for n in numbers]
    read = build.node("Concat", *parts, axis=1)
    signs = [number.sign for number in numbers]
    picked = _pick_inputs(build, read, places, [0.0] * len(numbers), signs)
    if stops:
        picked = _stopping(build, picked, numbers, task, parts_of)
    actions, _ = network(exported, build, picked)
    scaled = build.node("Mul", actions, build.constant("scale", controls.scale))
    resting = controls.at_joints(np.array(exported.origin or np.zeros(len(names))))
    driving = build.node("Add", scaled, build.constant("default", resting))
    for kind in dict.fromkeys(_LEAPPS.get(each, "") for each in controls.kinds):
        own = [i for i, each in enumerate(controls.kinds) if _LEAPPS.get(each, "") == kind]
        joints = [names[i] for i in own]
        name = f"{kind.rpartition('/')[2] or 'activation'}_target"
        build.give(build.node("Gather", driving, build.indices(own), axis=1), name)
        outputs.append(_tensor(name, kind, joints))
        gains = {"kp": controls.stiffness[own], "kd": controls.damping[own]}
        for key, values in gains.items() if kind == "target/joint/position" else ():
            build.give(build.constant(f"{key}_of_joints", values[None]), f"{key}_gains")
            outputs.append(_tensor(f"{key}_gains", key, joints))
    driven = [each["name"] for each in outputs]
    if "last_action" in first:
        build.give(actions, "last_action_out")
        outputs.append(_tensor("last_action_out", "", names))
    if "gait_phase" in first:
        outputs.append(_tensor("gait_phase_out", "", ("phase",), "float64"))
    if stops:
        outputs.append(_tensor("awake_out", "", ("steps",)))
    graph = build.graph(
        [build.declared(t["name"], *t["shape"], kind=t["dtype"]) for t in inputs],
        [build.declared(t["name"], *t["shape"], kind=t["dtype"]) for t in outputs],
    )
    content = model_of(graph, {})
    digests = {f"{each}sum": hashlib.new(each, content).hexdigest() for each in ("md5", "sha256")}
    flow: dict[str, Any] = {"data_flow": {}, "feedback_flow": feedback}
    if states:
        flow["initial_values"] = "policy_initial_values.safetensors"
        _write(folder / flow["initial_values"], _safetensors(states, inputs))
    fed = {goal.split("/")[1] for goals in feedback.values() for goal in goals}
    said = {
        "models": {
            "policy": {
                "inputs": inputs,
                "outputs": outputs,
                "parameters": {
                    "model_path": "policy.onnx",
                    **digests,
                    "backend": "onnx",
                    "opset_version": OPSET,
                },
            }
        },
        "pipeline": {
            "configs": {"frequency": 1.0 / task.dynamics.time_step},
            **flow,
            "inputs": {"policy": [t["name"] for t in inputs if t["name"] not in fed]},
            "outputs": {"policy": driven},
        },
        "system information": {"leapp config version": "1.3", "producer": "vgps_ros"},
    }
    _write(folder / "policy.onnx", content)
    _write(folder / "policy.yaml", _yaml(said))


_LEG = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle")
_HEAD = ("neck_pitch", "head_pitch", "head_yaw", "head_roll")
_DUCKS_JOINTS = (*(f"left_{each}" for each in _LEG), *_HEAD, *(f"right_{each}" for each in _LEG))
# What the Microduck tells a policy, by its names, and where our terms are in it; a clock follows.
_DUCKS = {"base_ang_vel": 3, "projected_gravity": 3, "joint_pos": 14, "joint_vel": 14,
          "actions": 14, "command": 3, "head_command": 4, "body_command": 6}  # fmt: skip
_TOLD, _MEASURED = sum(_DUCKS.values()), 34  # numbers; the measured ones come first
_DUCKS_PLACES = {"base_ang_vel": 0, "projected_gravity": 3, "joint_pos": 6, "joint_vel": 20,
                 LAST_ACTION: 34, "velocity_commands": 48, "gait_phase": _TOLD}  # fmt: skip
_DUCKS_RATE = 50  # [Hz]


def write_microduck(task: Task, exported: ExportedPolicy, folder: Path) -> str:
    """Writes policy.onnx and manifest.json, as a Microduck loads them; says how it is driven.

    Former steps, the clock's phase and the steps for which one that stops goes on are a memory of
    the network, which begins at zero. It is the sum of the tensors h and c that an LSTM has, of
    float32, and so has the digits of float64.

    Raises:
        InvalidInputError: the policy does not fit this robot.
    """
    controls, signals, names = task.controls, task.signals, task.controls.names
    if not np.isclose(task.dynamics.time_step * _DUCKS_RATE, 1.0):
        raise InvalidInputError(
            f"A Microduck is controlled every {1 / _DUCKS_RATE:g} s, but the task has a control "
            f"period of {task.dynamics.time_step:g} s; change control_period, and train anew."
        )
    numbers = _fitting_numbers(task, exported, "a Microduck", tuple(_DUCKS_PLACES))
    default = dict(zip(names, controls.at_joints(np.array(exported.origin)).tolist(), strict=True))
    path = Path(task.name)
    for pattern, change in read_task_file(path)[0].changes.joints.items() if path.is_file() else ():
        if change.lock is not None:
            default |= dict.fromkeys(fnmatch.filter(_HEAD, pattern), change.lock)
    if strange := sorted({*default} ^ {*_DUCKS_JOINTS}):
        raise InvalidInputError(
            f"A Microduck has servos of {', '.join(_DUCKS_JOINTS)}, but the task "
            f"{'drives' if strange[0] in default else 'does not drive'} {strange[0]}; use the "
            "robot's own model, of whose joints only those of the head may be locked."
        )
    own = [_DUCKS_JOINTS.index(name) for name in names]
    turns, history = any(n.term == "gait_phase" for n in numbers), max(n.lag for n in numbers)
    stops = bool(turns and task.unrest)
    began = turns + stops  # place in the memory of a one, behind which the former steps come
    size = began + (1 + _MEASURED * history if history else 0)
    build, following = Builder("float32"), list[str]()

    def part(value: str, first: int, end: int) -> str:
        return build.node("Gather", value, build.indices(range(first, end)), axis=1)

    obs = build.node("Cast", "obs", to=_DOUBLE)
    parts, memory = [obs], ""
    if size:
        halves = [build.node("Cast", f"{each}_in", to=_DOUBLE) for each in "hc"]
        memory = build.node("Reshape", build.node("Add", *halves), build.indices([1, size]))
    if turns:
        phase = part(memory, 0, 1)
        parts.append(_clock(build, phase, signals.frequency * task.dynamics.time_step))
        following.append("gait_phase_out")
    if history:
        now, begun = part(obs, 0, _MEASURED), build.constant("begun", [[1.0]])
        goes_on = build.node("Equal", part(memory, began, began + 1), begun)
        first = build.node("Concat", *[now] * history, axis=1)
        former = build.node("Where", goes_on, part(memory, began + 1, size), first)
        parts.append(build.node("Concat", now, former, axis=1))
        following += [begun, part(parts[-1], 0, _MEASURED * history)]
    places, offsets, factors = list[int](), list[float](), list[float]()
    for n in numbers:
        is_of_joint = n.term in ("joint_pos", "joint_vel", LAST_ACTION)
        place = _DUCKS_PLACES[n.term] + (own[n.index] if is_of_joint else n.index)
        places.append(place + (_TOLD + 2 * turns + _MEASURED * n.lag if n.lag else 0))
        offsets.append(default[names[n.index]] if n.term == "joint_pos" else 0.0)
        factors.append(n.sign / (controls.scale[n.index] if n.term == LAST_ACTION else 1.0))
    read = build.node("Concat", *parts, axis=1)
    picked = _pick_inputs(build, read, places, offsets, factors)
    if stops:
        felt = {"base_ang_vel": part(obs, 0, 3), "projected_gravity": part(obs, 3, 6)}
        felt["awake"] = part(memory, 1, 2)
        picked = _stopping(build, picked, numbers, task, felt)
        following.insert(1, build.node("Cast", "awake_out", to=_DOUBLE))
    actions, _ = network(exported, build, picked)
    to_joints = controls.scale[:, None] * np.eye(len(_DUCKS_JOINTS))[own]
    build.give(build.node("MatMul", actions, build.constant("to_joints", to_joints)), "actions")
    if size:
        whole = build.node("Concat", *following, axis=1)
        whole = build.node("Reshape", whole, build.indices([1, 1, size]))
        build.give(whole, "h_out")
        build.give(build.node("Sub", whole, build.node("Cast", "h_out", to=_DOUBLE)), "c_out")
    inputs = [build.declared("obs", 1, _TOLD)]
    outputs = [build.declared("actions", 1, len(_DUCKS_JOINTS))]
    for half in "hc" if size else "":
        inputs.append(build.declared(f"{half}_in", 1, 1, size))
        outputs.append(build.declared(f"{half}_out", 1, 1, size))
    graph = build.graph(inputs, outputs)
    lengths = {"obs_len": _TOLD, "action_len": len(_DUCKS_JOINTS)}
    pose = [default[joint] for joint in _DUCKS_JOINTS]
    metadata = {**lengths, "schema_version": 1, "control_hz": _DUCKS_RATE, "action_scale": 1.0,
                "joint_names": _DUCKS_JOINTS, "default_joint_pos": pose, "kp_fw": 200,
                "observation": [*_DUCKS.items()]}  # fmt: skip
    _write(folder / "policy.onnx", model_of(graph, {"microduck": json.dumps(metadata)}))
    told = {c.source: f"{c.name}, {c.lowest:g} to {c.highest:g} {c.unit}" for c in signals.commands}
    unused = "unused (zeros)"
    twist = [told.get(source, unused) for source in VELOCITY_COMMANDS]
    robot = {"model": "microduck", "hw_rev": 1, "servos": "xl330", "control_hz": _DUCKS_RATE}
    said = {"schema_version": 2, "model_api": 2 if size else 1, **lengths, "robot": robot,
            "name": folder.resolve().name.lower().removeprefix("microduck-"),
            "description": "Goes as it is commanded; learned by vgps_ros, in simulation alone.",
            "kind": "perpetual", "action_scale": 1.0, "slot": "walk", "entry_pose": "standing",
            "command": {"idle": [0, 0, 0], "twist": twist, "head": unused, "body": unused},
            "training": {"repo": "vgps_ros", "commit": commit(), "task_id": task.name}}  # fmt: skip
    _write(folder / "manifest.json", json.dumps(said, indent=2).encode())
    left = [joint for joint in _DUCKS_JOINTS if joint not in names]
    notes = [f"The robot holds {', '.join(left)} by its default pose."] if left else []
    if any(n.term == "joint_vel" for n in numbers):
        notes.append("The joint velocities that it tells the policy are one step old.")
    return " ".join(notes)


def _pick_inputs(
    build: Builder, read: str, places: list[int], offsets: list[float], factors: list[float]
) -> str:
    """Adds what picks a policy's inputs out of a vector, adds offsets and multiplies."""
    picked = build.node("Gather", read, build.indices(places), axis=1)
    moved = build.node("Add", picked, build.constant("offsets", offsets))
    return build.node("Mul", moved, build.constant("factors", factors))


def _clock(build: Builder, phase: str, turn: float) -> str:
    """Adds sine and cosine of a phase [turns], and the phase of the next step."""
    following = build.node("Add", phase, build.constant("turn", turn))
    whole = build.node("Floor", following)
    build.node("Sub", following, whole, output="gait_phase_out")
    angle = build.node("Mul", phase, build.constant("two_pi", 2.0 * np.pi))
    return build.node("Concat", build.node("Sin", angle), build.node("Cos", angle), axis=1)


def _stopping(
    build: Builder, picked: str, numbers: list[_Number], task: Task, values: Mapping[str, str]
) -> str:
    """Adds what stops the clock among a policy's inputs, as `robot.unrest` has it."""
    unrest, rest = task.unrest, dict(zip(task.signals.names, task.signals.rest, strict=False))
    assert unrest
    axis, rate = build.indices([1]), values["base_ang_vel"]

    def summed(value: str) -> str:
        return build.node("ReduceSum", value, axis)

    up = build.node("Neg", values["projected_gravity"])
    upright = summed(build.node("Mul", up, build.constant("upright", unrest.up[None])))
    level = build.node("Sub", rate, build.node("Mul", summed(build.node("Mul", rate, up)), up))
    speed = summed(build.node("Mul", level, level))
    tilted = build.node("Less", upright, build.constant("cosine_of_tilt", np.cos(TILT)))
    fast = build.node("Greater", speed, build.constant("squared_rate", RATE**2))
    steps = build.constant("steps", float(unrest.steps))
    left = build.node("Where", build.node("Or", tilted, fast), steps, values["awake"])
    zero = build.constant("zero", 0.0)
    following = build.node("Sub", left, build.constant("one_step", 1.0))
    build.give(build.node("Max", following, zero), "awake_out")
    told = [i for i, number in enumerate(numbers) if number.name in rest]
    at_rest = np.array([[rest[numbers[i].name] for i in told]], dtype=np.float32)
    commands = build.node("Gather", picked, build.indices(told), axis=1)
    moved = build.node("Sub", commands, build.constant("at_rest", at_rest))
    moves = build.node("Greater", summed(build.node("Abs", moved)), zero)
    turns = build.node("Or", moves, build.node("Greater", left, zero))
    others = [float(number.term != "gait_phase") for number in numbers]
    stays = build.node("Greater", build.constant("no_clock", [others]), zero)
    return build.node("Where", build.node("Or", turns, stays), picked, zero)


def _gravity(build: Builder, rotation: str) -> str:
    """Adds gravity's direction in a frame with this quaternion (x, y, z, w)."""
    by_axis = build.node("MatMul", rotation, build.constant("of_axes", _GRAVITY.reshape(4, 12)))
    by_axis = build.node("Reshape", by_axis, build.indices([1, 3, 4]))
    column = build.node("Reshape", rotation, build.indices([1, 4, 1]))
    return build.node("Reshape", build.node("MatMul", by_axis, column), build.indices([1, 3]))


def _tensor(
    name: str, kind: str, elements: tuple[str, ...] | list[str], dtype: str = "float32"
) -> dict[str, Any]:
    found = {"name": name, "dtype": dtype, "shape": [1, len(elements)], "type": "tensor"}
    return {**found, **({"kind": kind} if kind else {}), "element_names": [[*elements]]}


def _safetensors(states: Mapping[str, Array], inputs: list[dict[str, Any]]) -> bytes:
    """Returns the bytes of a safetensors file: a header in JSON, and the numbers."""
    kinds = {f"policy/{tensor['name']}": tensor["dtype"] for tensor in inputs}
    header, content = dict[str, Any](), b""
    for key, values in states.items():
        own = values.astype(np.dtype(kinds[key]).newbyteorder("<")).tobytes()
        offsets = [len(content), len(content) + len(own)]
        header[key] = {"dtype": "F64" if kinds[key] == "float64" else "F32",
                       "shape": [*values.shape], "data_offsets": offsets}  # fmt: skip
        content += own
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + content


def _yaml(content: Mapping[str, Any]) -> bytes:
    text: str = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    return text.encode()


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        file.write(content)
