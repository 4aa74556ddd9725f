# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The paper's mathematics: DDP, q(ζ) and its marginals, the policy, its cost and its fit."""
