# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads what other projects write beside their policies, as the metadata of `policies.contract`.

A LEAPP bundle is a YAML file that says what an ONNX file's tensors are, and what each state begins
with. `read_leapp` joins the tensors that go in to one vector, and those that drive the robot, with
the states behind them, to another.
"""

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.core.checks import check_spelling, nearest, one_of, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.policies.contract import BASE, HELD, STATE
from vgps_ros.policies.onnx_file import (
    LARGEST,
    joined_tensors,
    names_of,
    with_commas,
    with_metadata,
)
from vgps_ros.policies.onnx_policy import constants_of
from vgps_ros.robot.controls import Controls
from vgps_ros.storage.files import read_file, read_yaml

_SAME = ("base_lin_vel", "base_ang_vel", "projected_gravity", "last_action", "velocity_commands")
_OF_UNITREE = {
    **{name: name for name in (*_SAME, "gait_phase")},
    "joint_pos_rel": "joint_pos",
    "joint_vel_rel": "joint_vel",
    "keyboard_velocity_commands": "velocity_commands",
}
# With the key of its scale.
_OF_RL_SAR = {
    "lin_vel": ("base_lin_vel", "lin_vel_scale"),
    "ang_vel": ("base_ang_vel", "ang_vel_scale"),
    "gravity_vec": ("projected_gravity", ""),
    "commands": ("velocity_commands", "commands_scale"),
    "dof_pos": ("joint_pos", "dof_pos_scale"),
    "dof_vel": ("joint_vel", "dof_vel_scale"),
    "actions": ("last_action", ""),
    "g1_phase": ("gait_phase", ""),
    "RoboMimic_Deploy/phase": ("phase", ""),
}
_KEYS_OF_UNITREE = (
    *("joint_ids_map", "step_dt", "stiffness", "damping", "default_joint_pos"),
    *("commands", "actions", "observations"),
)
_OF_ACTION = ("clip", "joint_names", "scale", "offset", "joint_ids")
_OF_TERM = ("params", "clip", "scale", "history_length")
_KEYS_OF_RL_SAR = (
    *("rl_kp", "rl_kd", "fixed_kp", "fixed_kd", "default_dof_pos", "action_scale"),
    *("observations", "observations_history", "observations_history_priority"),
    *("clip_obs", "clip_actions_lower", "clip_actions_upper", "wheel_indices"),
    *("joint_names", "joint_mapping", "state_mapping", "dt", "decimation"),
    # What tells nothing of the network's numbers; torques are limited by the executor.
    *("model_name", "framework", "num_observations", "num_of_dofs", "torque_limits"),
    *("joint_controller_names", "command_mapping", "waist_joint_indices"),
)
_PERIOD_OF_G1, _MOTION_OF_G1 = 0.8, 18.0  # of rl_sar's g1_phase and RoboMimic_Deploy/phase [s]


def read_contract(path: Path, joints: Sequence[str]) -> dict[str, str]:
    """Returns the metadata that a file of another project stands for.

    Args:
        path: Unitree's deploy.yaml, rl_sar's config.yaml, or a YAML file of the metadata
            themselves.
        joints: the robot's joints, in the order of its motors.

    Raises:
        InvalidInputError: it cannot be read, or holds what no contract can say.
    """
    content = _yaml(path)
    try:
        if "joint_ids_map" in content:
            return _to_metadata_text(_of_unitree(content, joints))
        one = next(iter(content.values())) if len(content) == 1 else {}
        if isinstance(one, Mapping) and "rl_kp" in one:
            bases = (folder / "base.yaml" for folder in list(path.absolute().parents)[1:3])
            base = next(filter(Path.is_file, bases), None)
            shared = next(iter(_yaml(base).values())) if base else {}
            return _to_metadata_text(_of_rl_sar({**shared, **one}, joints))
    except InvalidInputError:
        raise
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InvalidInputError(
            f"'{path}' lacks {error}, or has it in another form; write its metadata as YAML."
        ) from error
    if "observation_names" not in content:
        raise InvalidInputError(
            f"'{path}' is neither a deploy.yaml of Unitree (joint_ids_map), nor a config.yaml of "
            "rl_sar (rl_kp), nor holds metadata (observation_names); see "
            "docs/how_to/import_a_policy.md."
        )
    return _to_metadata_text(content)


# Of LEAPP's kinds of inputs: the words that stand for the names of their elements.
_OF_LEAPP = {
    "state/joint/position": "{}/position",
    "state/joint/velocity": "{}/velocity",
    "state/body/position": f"{BASE}/{{}}",
    "state/body/rotation": f"{BASE}/{{}}",
}
_VECTORS_OF_LEAPP = {
    "state/body/linear_velocity": "base_lin_vel",
    "state/body/angular_velocity": "base_ang_vel",
    "command/body/velocity": "velocity_commands",
}
_ELEMENTS = {
    "state/body/position": ("x", "y", "z"),
    "state/body/rotation": ("qx", "qy", "qz", "qw"),
}
_DRIVEN_BY = {
    "target/joint/position": "position",
    "target/joint/velocity": "velocity",
    "target/joint/effort": "torque",
    "target/joint/torques": "torque",
}
_GAINS = {"kp": "joint_stiffness", "kd": "joint_damping"}
_MOST = 100_000  # numbers of a tensor
_NUMBERS = {"F32": "<f4", "F64": "<f8", "I32": "<i4", "I64": "<i8", "U8": "u1", "BOOL": "?"}


def read_leapp(path: Path, joints: Sequence[str], home: Sequence[float]) -> bytes:
    """Returns an ONNX file with metadata that computes what a LEAPP bundle of one network does.

    Args:
        path: the YAML file of the bundle.
        joints: the robot's joints.
        home: what an action of 0 asks: their positions in the keyframe home, or at the start.

    Raises:
        InvalidInputError: the bundle cannot be read, or holds what no contract can say.
    """
    try:
        return _of_leapp(_yaml(path), path, dict(zip(joints, home, strict=True)))
    except InvalidInputError:
        raise
    except (OSError, LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InvalidInputError(
            f"'{path}' is no LEAPP bundle, since it lacks {error}, or has it in another form."
        ) from error


def _of_leapp(bundle: Mapping[str, Any], path: Path, home: Mapping[str, float]) -> bytes:
    models, pipeline, name = bundle["models"], bundle["pipeline"], f"'{path}'"
    if len(models) != 1:
        raise InvalidInputError(
            f"{name} has the networks {quote([*models])}, but one can be executed; export the "
            "policy as one."
        )
    ((node, described),) = models.items()
    parameters = described["parameters"]
    one_of(f"the backend of {name}", parameters["backend"], ["onnx"])
    content = read_file(_beside(path, parameters["model_path"]), LARGEST)
    if hashlib.sha256(content).hexdigest() != parameters["sha256sum"]:
        raise InvalidInputError(
            f"'{parameters['model_path']}' is not the file that {name} describes; export anew."
        )
    flow = pipeline.get("feedback_flow") or {}
    sources = {goal: source for source, goals in flow.items() for goal in goals}
    first = pipeline.get("initial_values")
    begins = _safetensors(_beside(path, first)) if first else {}
    read, said, states = dict[str, int](), list[str](), list[tuple[str, str]]()
    begun = list[float]()
    for tensor in described["inputs"]:
        key, size = f"{node}/{tensor['name']}", math.prod(tensor["shape"])
        if not 0 < size <= _MOST:
            raise InvalidInputError(f"{name} reads {size} numbers of {key}; use a smaller network.")
        read[tensor["name"]] = size
        if key in sources:
            states.append((tensor["name"], sources[key].split("/")[1]))
            begun += np.broadcast_to(begins.get(key, np.zeros(size)).ravel(), size).tolist()
        else:
            said += _terms_of_leapp(tensor, size, name)
    driving = [t for t in described["outputs"] if t.get("kind") in _DRIVEN_BY]
    joints = [(j, t["kind"]) for t in driving for j in _elements(t, math.prod(t["shape"]), name)]
    gains = {t["name"]: t for t in described["outputs"] if t.get("kind") in _GAINS}
    fed = [source for _, source in states]
    for tensor in described["outputs"]:
        if tensor not in driving and tensor["name"] not in (*gains, *fed):
            raise InvalidInputError(
                f"The output '{tensor['name']}' of {name} has the kind "
                f"{quote(tensor.get('kind', 'none'))}, which drives nothing here; known are "
                f"{', '.join([*_DRIVEN_BY, *_GAINS])}."
            )
    places, end = dict[str, range](), 0
    for each in sorted(read, key=lambda each: any(each == state for state, _ in states)):
        places[each] = range(end, end := end + read[each])
    start = [home.get(j, 0.0) * (_DRIVEN_BY[kind] == "position") for j, kind in joints]
    outputs, less = [*(t["name"] for t in driving), *fed], [*start, *[0.0] * len(begun)]
    whole = joined_tensors(content, places, outputs, less, name)
    rate = (pipeline.get("configs") or {}).get("frequency")
    found = {
        "joint_names": with_commas([joint for joint, _ in joints]),
        "default_joint_pos": with_commas(start),
        "action_kind": with_commas([_DRIVEN_BY[kind] for _, kind in joints]),
        "observation_names": with_commas([*said, *["state"] * bool(states)]),
        "control_period": repr(1.0 / float(rate)) if rate else "0",
        STATE: with_commas(begun),
    }
    own = {key: dict.fromkeys((joint for joint, _ in joints), 0.0) for key in _GAINS.values()}
    for each, values in constants_of(content, list(gains), name).items():
        names = _elements(gains[each], len(values), name)
        known = own[_GAINS[gains[each]["kind"]]]
        known |= {j: float(v) for j, v in zip(names, values, strict=True) if j in known}
    found |= {key: with_commas(list(values.values())) for key, values in own.items()}
    return with_metadata(whole, found, name)


def _beside(path: Path, name: str) -> Path:
    """Returns the file of a name in the folder of another."""
    file = path.parent / name
    if not file.resolve().is_relative_to(path.parent.resolve()):
        raise InvalidInputError(f"'{path}' names '{file}', which is not in its folder.")
    return file


def _elements(tensor: Mapping[str, Any], size: int, name: str) -> list[str]:
    """Returns the names of a tensor's elements."""
    axes = [axis for axis in tensor.get("element_names") or [] if isinstance(axis, list)]
    found = axes[0] if len(axes) == 1 else tensor.get("element_names") or []
    if len(axes) > 1 or len(found) != size:
        raise InvalidInputError(
            f"The tensor '{tensor['name']}' of {name} has {size} elements, but its element_names "
            f"are {quote(tensor.get('element_names'))}; name each element once."
        )
    return [str(each) for each in found]


def _terms_of_leapp(tensor: Mapping[str, Any], size: int, name: str) -> list[str]:
    """Returns the terms of an input; without a kind its elements have the names of readings."""
    kind, known = tensor.get("kind", ""), [*_OF_LEAPP, *_VECTORS_OF_LEAPP]
    if kind in _VECTORS_OF_LEAPP and size == len("xyz"):
        return [_VECTORS_OF_LEAPP[kind]]
    if kind == "state/vector3d" and "gravity" in tensor["name"]:
        return ["projected_gravity"]
    if kind not in _OF_LEAPP and (kind or not tensor.get("element_names")):
        raise InvalidInputError(
            f"The input '{tensor['name']}' of {name} has the kind {quote(kind)} and {size} "
            f"numbers; known are {', '.join(known)}, or none with readings as element_names."
            f"{nearest(kind, known)}"
        )
    ordered = _ELEMENTS.get(kind) if not tensor.get("element_names") else None
    return [_OF_LEAPP.get(kind, "{}").format(e) for e in ordered or _elements(tensor, size, name)]


def _safetensors(path: Path) -> dict[str, Array]:
    """Returns the arrays in a safetensors file: a header in JSON, and the bytes."""
    content = read_file(path)
    end = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:end])
    return {
        key: np.frombuffer(content[end:][slice(*entry["data_offsets"])], _NUMBERS[entry["dtype"]])
        .reshape(entry["shape"])
        .astype(float)
        for key, entry in header.items()
        if key != "__metadata__"
    }


def holding_metadata(
    metadata: dict[str, str], controls: Controls, start: Array, stiffness: float, damping: float
) -> dict[str, str]:
    """Returns metadata by which the controls that a policy does not drive hold where a task starts.

    Args:
        metadata: of the policy.
        controls: what the robot's controls are.
        start: a state in that pose, shape (n_x,).
        stiffness: of motors [N·m/rad]; servos have their own.
        damping: of motors [N·m·s/rad].
    """
    driven = names_of(metadata, "joint_names", "The policy")
    idle = [i for i, joint in enumerate(controls.names) if joint not in driven]
    if HELD in metadata or not idle:
        return {}
    places, is_servo = controls.at_joints(controls.resting(start)), controls.are_servos
    places = np.where(is_servo, places, controls.positions @ start)
    gains = np.array([[stiffness], [damping]]) * ~is_servo
    return {
        HELD: with_commas([controls.names[i] for i in idle]),
        "held_joint_pos": with_commas(places[idle].tolist()),
        "held_joint_stiffness": with_commas(gains[0, idle].tolist()),
        "held_joint_damping": with_commas(gains[1, idle].tolist()),
    }


def _yaml(path: Path) -> dict[str, Any]:
    try:
        text = read_file(path).decode()
    except (OSError, UnicodeError) as error:
        raise InvalidInputError(f"'{path}' cannot be read: {error}.") from error
    content = read_yaml(re.sub(r"!!python/\S+", "", text), f"'{path}'")
    if not isinstance(content, dict):
        raise InvalidInputError(f"'{path}' must hold keys with values, as a deploy.yaml does.")
    return content


def _to_metadata_text(content: Mapping[str, Any]) -> dict[str, str]:
    """Returns values as texts: lists with commas, and within them with semicolons."""
    found = {}
    for key, value in content.items():
        values = value if isinstance(value, list) else str(value).split(",")
        rows = [row if isinstance(row, list | tuple) else [row] for row in values]
        found[str(key)] = with_commas([";".join(map(str, row)) for row in rows])
    return found


def _known(name: str, terms: Mapping[str, Any]) -> Any:
    if name not in terms:
        raise InvalidInputError(
            f"The term {quote(name)} is none of {', '.join(terms)}; write its metadata as YAML, "
            f"with a reading of the robot in its place.{nearest(name, terms)}"
        )
    return terms[name]


def _of_unitree(content: Mapping[str, Any], joints: Sequence[str]) -> dict[str, Any]:
    """Converts a deploy.yaml: gains in the motors' order, all else in the policy's."""
    check_spelling("The deploy.yaml", content, _KEYS_OF_UNITREE)
    order = _order(content["joint_ids_map"], joints)
    if len(content["actions"]) != 1:
        raise InvalidInputError("The actions of deploy.yaml must be one term, of all joints.")
    ((kind, action),) = content["actions"].items()
    one_of("the action of deploy.yaml", kind, ["JointPositionAction"])
    check_spelling(f"{kind} of deploy.yaml", action, _OF_ACTION)
    offset, start = action.get("offset"), content["default_joint_pos"]
    ids = [i for i in action.get("joint_ids") or [] if i is not None]
    if ids not in ([], [*range(len(order))]):
        raise InvalidInputError("The action of deploy.yaml must be of all joints, not joint_ids.")
    if offset is not None and not np.allclose(offset, start):
        raise InvalidInputError("The offset of deploy.yaml must be its default_joint_pos.")
    terms = dict(content["observations"])
    by_time, scale_first = (terms.pop(k, False) for k in ("use_gym_history", "scale_first"))
    for name, term in terms.items():
        check_spelling(f"{name} of deploy.yaml", term, _OF_TERM)
        if (term.get("params") or {}).get("asset_cfg", {}).get("joint_ids"):
            raise InvalidInputError(f"{name} of deploy.yaml must be of all joints, not joint_ids.")
        if scale_first and term.get("clip"):
            raise InvalidInputError("Clips of deploy.yaml must come before scales.")
    found = {
        "joint_names": [joints[i] for i in order],
        "joint_stiffness": [content["stiffness"][i] for i in order],
        "joint_damping": [content["damping"][i] for i in order],
        "default_joint_pos": start,
        "action_scale": action["scale"],
        "observation_names": [_known(name, _OF_UNITREE) for name in terms],
        "observation_terms_scale": [term.get("scale") or 1.0 for term in terms.values()],
        "observation_terms_clip": [
            term.get("clip") or [-np.inf, np.inf] for term in terms.values()
        ],
        "observation_terms_history_length": [
            term.get("history_length", 1) for term in terms.values()
        ],
        "observation_order": "time" if by_time else "term",
        "control_period": content["step_dt"],
    }
    if action.get("clip"):
        found["target_clip"] = action["clip"]
    if "gait_phase" in terms:
        found["gait_period"] = terms["gait_phase"]["params"]["period"]
    return found


def _of_rl_sar(content: Mapping[str, Any], joints: Sequence[str]) -> dict[str, Any]:
    """Converts a config.yaml, with the base.yaml beside its folder."""
    scales = [key for _, key in _OF_RL_SAR.values()]
    check_spelling("The config.yaml", content, [*_KEYS_OF_RL_SAR, *scales])
    names = content.get("joint_names", joints)
    count = len(content["rl_kp"])
    mapping = content.get("joint_mapping", content.get("state_mapping", [*range(count)]))
    order = _order(mapping, names)
    if content.get("wheel_indices"):
        raise InvalidInputError("Wheels of rl_sar's config.yaml cannot be driven; use legs alone.")
    terms = [_known(name, _OF_RL_SAR) for name in content["observations"]]
    lags = content.get("observations_history") or [0]
    clip = float(content.get("clip_obs", np.inf))
    lowest = content.get("clip_actions_lower") or [-np.inf] * count
    highest = content.get("clip_actions_upper") or [np.inf] * count
    found = {
        "joint_names": [names[i] for i in order],
        "joint_stiffness": content["rl_kp"],
        "joint_damping": content["rl_kd"],
        "default_joint_pos": content["default_dof_pos"],
        "action_scale": content["action_scale"],
        "action_clip": [[low, high] for low, high in zip(lowest, highest, strict=True)],
        "observation_names": [name for name, _ in terms],
        "observation_terms_scale": [content[key] if key else 1.0 for _, key in terms],
        "observation_terms_lags": [lags for _ in terms],
        "observation_order": content.get("observations_history_priority", "time"),
        "observation_clip": [[-clip, clip]],
    }
    if "g1_phase" in content["observations"]:
        found["gait_period"] = _PERIOD_OF_G1
    if "RoboMimic_Deploy/phase" in content["observations"]:
        found["phase_frequency"] = 1.0 / _MOTION_OF_G1
    if "dt" in content:
        found["control_period"] = content["dt"] * content["decimation"]
    return found


def _order(mapping: Sequence[int], joints: Sequence[str]) -> list[int]:
    if len({*mapping}) < len(mapping) or not {*mapping} <= {*range(len(joints))}:
        raise InvalidInputError(
            f"The policy's joints are numbers {list(mapping)} of the robot's, but it has "
            f"{len(joints)}: {', '.join(joints)}; use the policy of this robot."
        )
    return [int(i) for i in mapping]
