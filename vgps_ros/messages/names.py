# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Names on which nodes, bags and views agree: topics, message types, keys on /diagnostics."""

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from ament_index_python import get_package_share_directory, get_resource

from vgps_ros.core.errors import InvalidInputError

# Topics that describe the robot: MJCF for this project's nodes, URDF for all others.
MJCF, URDF = "mjcf_description", "robot_description"

# What a controller is told: some commands as fields of a Twist, any by their names.
CMD_VEL, COMMAND = "cmd_vel", "command"
# What it was told in each state that it answered.
CONTEXT = "context"

# The gains of the loops that a robot's joints close.
GAINS = "joint_gains"

# True on it, latched, or by the controller's service of this name: the safe action drives.
EMERGENCY_STOP = "emergency_stop"

# Keys of values that controllers show on /diagnostics.
COMMANDS_SENT = "commands sent"  # key of a value: how many since the node's start
IS_ACTIVE = "active"  # key of a value: True between activation and deactivation
PLAN_AGE, PLAN_COST, PLAN_DURATION = "plan age", "plan cost", "plan duration"  # keys of values
POLICY_OF_ITERATION = "policy of iteration"  # key of a value: of the policy that drives
POSE = "pose"  # key of a value: what the robot does where neither a policy nor plans drive
SAFE_ACTION = "safe action active"  # key of a value: True while it drives, and not the controller


def driver(message: str, values: Mapping[str, str]) -> str | None:
    """Returns who drives the robot and why, by a node's status; None if it is no controller."""
    if COMMANDS_SENT not in values:
        return None
    if values.get(IS_ACTIVE) != "True":
        return "nobody: the controller is not active."
    if values.get(SAFE_ACTION) == "True":
        return f"the safe action. {message}"
    if values[COMMANDS_SENT] == "0":
        return f"nobody yet. {message}"
    if values.get(POSE):
        return f"nobody: it {values[POSE]}. {message}"
    if PLAN_AGE in values:
        keys = [key for key in (PLAN_AGE, PLAN_COST, PLAN_DURATION) if key in values]
        return f"plans: {', '.join(f'{key} {values[key]}' for key in keys)}. {message}"
    if POLICY_OF_ITERATION in values:
        k = values[POLICY_OF_ITERATION]
        return f"the policy of {'a file' if k == '0' else f'iteration {k}'}. {message}"
    return message


def message_type(kind: str) -> type:
    """Returns the class of a type such as `sensor_msgs/msg/JointState`.

    Services and actions have types too, such as `std_srvs/srv/SetBool_Event`.

    The name may come from a bag or from another host, so that only what an installed interface
    package lists is imported.

    Raises:
        InvalidInputError: its package is not installed, or has no such message.
    """
    try:
        package, space, name = kind.split("/")
        listed = get_resource("rosidl_interfaces", package)[0].split() if package else []
        if f"{file_of(kind)}.idl" not in listed:  # one is made of each .msg file
            raise LookupError(kind)
        module, call = import_module(f"{package}.{space}"), name.partition("_FeedbackMessage")
        found: type = (
            getattr(module, call[0]).Impl.FeedbackMessage if call[1] else getattr(module, name)
        )
    except (LookupError, ImportError, AttributeError, ValueError, OSError) as error:
        raise InvalidInputError(
            f"the type {kind} is not installed; build or source its package."
        ) from error
    return found


def file_of(kind: str) -> str:
    """Returns where a package defines a type, without the ending: `srv/SetBool` for its events."""
    _, _, place = kind.partition("/")
    return place if place.startswith("msg/") else place.rpartition("_")[0]


def installed_hash(kind: str) -> str:
    """Returns the RIHS01 hash of a type of messages that is installed; empty if it has none.

    Raises:
        InvalidInputError: its package is not installed.
    """
    message_type(kind)
    file = Path(get_package_share_directory(kind.partition("/")[0]), f"{file_of(kind)}.json")
    hashes = json.loads(file.read_text())["type_hashes"] if file.is_file() else []
    return {each["type_name"]: each["hash_string"] for each in hashes}.get(kind, "")
