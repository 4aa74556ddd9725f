# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a robot is, and a first task for it: the work behind `vgps new` and `vgps check`."""
