# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Plans controls by sampling: predictive sampling and the cross-entropy method."""
