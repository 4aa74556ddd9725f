# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Differential dynamic programming in the iterative LQR form of section 4."""
