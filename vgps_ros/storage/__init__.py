# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files of policies, trajectory distributions and checkpoints, which can run no code."""
