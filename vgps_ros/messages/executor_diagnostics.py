# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The words of controllers on /diagnostics on which others rely."""

from collections.abc import Mapping

COMMANDS_SENT = "commands sent"  # key of a value: how many since the node's start
IS_ACTIVE = "active"  # key of a value: True between activation and deactivation
PLAN_AGE, PLAN_COST, PLAN_DURATION = "plan age", "plan cost", "plan duration"  # keys of values
OWNS = "owns"  # key of a value: the topics that this node alone may publish
POLICY_OF_ITERATION = "policy of iteration"  # key of a value: of the policy that drives
SAFE_ACTION_DRIVES = "Not the controller drives, but the safe action"  # begins a status's sentence


def driver(message: str, values: Mapping[str, str]) -> str | None:
    """Returns who drives the robot and why, by a node's status; None if it is no controller.

    Args:
        message: the status's sentences.
        values: its values by key.
    """
    if COMMANDS_SENT not in values:
        return None
    if values.get(IS_ACTIVE) != "True":
        return "nobody: the controller is not active."
    if SAFE_ACTION_DRIVES in message:
        return f"the safe action. {message}"
    if values[COMMANDS_SENT] == "0":
        return f"nobody yet. {message}"
    if PLAN_AGE in values:
        keys = [key for key in (PLAN_AGE, PLAN_COST, PLAN_DURATION) if key in values]
        return f"plans: {', '.join(f'{key} {values[key]}' for key in keys)}. {message}"
    if POLICY_OF_ITERATION in values:
        return f"the policy of iteration {values[POLICY_OF_ITERATION]}. {message}"
    return message
