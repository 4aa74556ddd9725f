# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a robot is to a policy: its bodies, its controls, what a policy is told, and execution."""
