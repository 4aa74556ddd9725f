# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs in this process: training, evaluation, and the comparison of Figure 1."""
