# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `policy_learner`, and what serves it alone."""

from vgps_ros.nodes.policy_learner.node import NODE

__all__ = ["NODE"]
