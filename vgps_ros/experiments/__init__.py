# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Whole trainings in this process."""
