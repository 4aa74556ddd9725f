# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The words of policy_executor on /diagnostics on which a check of its bag relies."""

COMMANDS_SENT = "commands sent"  # key of a value: how many since the node's start
IS_ACTIVE = "active"  # key of a value: True between activation and deactivation
POLICY_OF_ITERATION = "policy of iteration"  # key of a value: of the policy that drives
SAFE_ACTION_DRIVES = "Not the controller drives, but the safe action"  # begins a status's sentence
