# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `live`, and what serves it alone."""

from vgps_ros.nodes.live.node import NODE

__all__ = ["NODE"]
