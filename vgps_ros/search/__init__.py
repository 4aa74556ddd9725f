# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Policy search methods: one file each, one shape for all."""
