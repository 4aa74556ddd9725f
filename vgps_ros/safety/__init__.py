# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Protects a robot from its learned policy, without any middleware.

For each state, `Supervisor` decides whether the robot gets the policy's controls, within limits, or
those of the safe action.
"""
