# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes: each declares, converts, calls the core and publishes."""
