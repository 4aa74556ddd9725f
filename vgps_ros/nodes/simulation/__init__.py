# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `simulation`, and what serves it alone."""

from vgps_ros.nodes.simulation.node import NODE

__all__ = ["NODE"]
