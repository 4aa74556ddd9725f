# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""MuJoCo models as discrete dynamics x' = f(x, u): rollouts, derivatives, names of joints."""
