# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The method, free of any middleware: dynamics, DDP, marginals, policy and its fit."""
