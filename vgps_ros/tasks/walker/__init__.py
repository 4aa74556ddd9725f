# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The paper's walker, whose first motion is that of a hand-crafted controller."""
