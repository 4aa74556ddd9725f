# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""How fast vgps_ros is, as ratios to peers and to floors that are measured in the same run."""
