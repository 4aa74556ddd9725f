# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Plots, Rerun recordings and progress on the terminal: everything that people look at."""
