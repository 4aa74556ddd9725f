# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The comparison of Figure 1 of the paper: all methods, on every panel, over several seeds."""
