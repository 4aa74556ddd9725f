# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Messages of the graph to records of the core and back; no node, no middleware at run time."""
