# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads what other projects write beside their policies, as the metadata of `policies.contract`."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.core.checks import nearest, one_of, quoted
from vgps_ros.core.controls import Controls
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.policies.contract import HELD
from vgps_ros.policies.onnx_file import names_of, with_commas
from vgps_ros.storage.files import read_yaml

GO1_OF_PLAYGROUND = "playground-go1"
_OF_UNITREE = {
    "base_lin_vel": "base_lin_vel",
    "base_ang_vel": "base_ang_vel",
    "projected_gravity": "projected_gravity",
    "joint_pos_rel": "joint_pos",
    "joint_vel_rel": "joint_vel",
    "last_action": "last_action",
    "velocity_commands": "velocity_commands",
    "keyboard_velocity_commands": "velocity_commands",
    "gait_phase": "gait_phase",
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
}


def read_contract(path: Path, joints: Sequence[str], home: Sequence[float]) -> dict[str, str]:
    """Returns the metadata that a file of another project stands for.

    Args:
        path: Unitree's deploy.yaml, rl_sar's config.yaml, a YAML file of the metadata themselves,
            or GO1_OF_PLAYGROUND, the observations of MuJoCo Playground's Go1.
        joints: the robot's joints, in the order of its motors.
        home: their positions in the keyframe home, or in the task's start.

    Raises:
        InvalidInputError: it cannot be read, or holds what no contract can say.
    """
    if str(path) == GO1_OF_PLAYGROUND:
        return _said(_of_playground(joints, home))
    content = _yaml(path)
    try:
        if "joint_ids_map" in content:
            return _said(_of_unitree(content, joints))
        one = next(iter(content.values())) if len(content) == 1 else {}
        if isinstance(one, Mapping) and "rl_kp" in one:
            base = path.parent.parent / "base.yaml"
            shared = next(iter(_yaml(base).values())) if base.is_file() else {}
            return _said(_of_rl_sar({**shared, **one}, joints))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InvalidInputError(
            f"'{path}' lacks {error}, or has it in another form; write its metadata as YAML."
        ) from error
    if "observation_names" not in content:
        raise InvalidInputError(
            f"'{path}' is neither a deploy.yaml of Unitree (joint_ids_map), nor a config.yaml of "
            "rl_sar (rl_kp), nor holds metadata (observation_names); see "
            "docs/how_to/import_a_policy.md."
        )
    return _said(content)


def holding(
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
        text = path.read_text()
    except (OSError, UnicodeError) as error:
        raise InvalidInputError(f"'{path}' cannot be read: {error}.") from error
    content = read_yaml(re.sub(r"!!python/\S+", "", text), f"'{path}'")
    if not isinstance(content, dict):
        raise InvalidInputError(f"'{path}' must hold keys with values, as a deploy.yaml does.")
    return content


def _said(content: Mapping[str, Any]) -> dict[str, str]:
    """Returns values as texts: lists with commas, and within them with semicolons."""
    found = {}
    for key, value in content.items():
        rows = [row if isinstance(row, list | tuple) else [row] for row in _rows(value)]
        found[str(key)] = with_commas([";".join(map(str, row)) for row in rows])
    return found


def _rows(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _known(name: str, terms: Mapping[str, Any]) -> Any:
    if name not in terms:
        raise InvalidInputError(
            f"The term {quoted(name)} is none of {', '.join(terms)}; write its metadata as YAML, "
            f"with a reading of the robot in its place.{nearest(name, terms)}"
        )
    return terms[name]


def _of_unitree(content: Mapping[str, Any], joints: Sequence[str]) -> dict[str, Any]:
    """Converts a deploy.yaml: gains in the motors' order, all else in the policy's."""
    order = _order(content["joint_ids_map"], joints)
    kind, action = next(iter(content["actions"].items()))
    one_of("the action of deploy.yaml", kind, ["JointPositionAction"])
    offset, start = action.get("offset"), content["default_joint_pos"]
    ids = [i for i in action.get("joint_ids") or [] if i is not None]
    if len(content["actions"]) > 1 or action.get("clip") or ids not in ([], [*range(len(order))]):
        raise InvalidInputError("The actions of deploy.yaml must be one term, of all joints.")
    if offset is not None and not np.allclose(offset, start):
        raise InvalidInputError("The offset of deploy.yaml must be its default_joint_pos.")
    terms = dict(content["observations"])
    by_time = terms.pop("use_gym_history", False)
    if terms.pop("scale_first", False) and any(term.get("clip") for term in terms.values()):
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
    if "gait_phase" in terms:
        found["gait_period"] = terms["gait_phase"]["params"]["period"]
    return found


def _of_rl_sar(content: Mapping[str, Any], joints: Sequence[str]) -> dict[str, Any]:
    """Converts a config.yaml, with the base.yaml beside its folder."""
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
    if "dt" in content:
        found["control_period"] = content["dt"] * content["decimation"]
    return found


def _of_playground(joints: Sequence[str], home: Sequence[float]) -> dict[str, Any]:
    velocities = [f"{name}/{axis}" for name in ("local_linvel", "gyro") for axis in "xyz"]
    terms = ["projected_gravity", "joint_pos", "joint_vel", "last_action", "velocity_commands"]
    return {
        "joint_names": [*joints],
        "default_joint_pos": [*home],
        "action_scale": 0.5,
        "observation_names": [*velocities, *terms],
        "control_period": 0.02,
    }


def _order(mapping: Sequence[int], joints: Sequence[str]) -> list[int]:
    if len({*mapping}) < len(mapping) or not {*mapping} <= {*range(len(joints))}:
        raise InvalidInputError(
            f"The policy's joints are numbers {list(mapping)} of the robot's, but it has "
            f"{len(joints)}: {', '.join(joints)}; use the policy of this robot."
        )
    return [int(i) for i in mapping]
