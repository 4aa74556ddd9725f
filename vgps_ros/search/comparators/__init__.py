# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Other methods of policy search, with which the paper or this project compares its own."""
