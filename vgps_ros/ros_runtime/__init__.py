# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The parts that nodes share: how they run and end, parameters, health, and who is alive."""
