# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Plots, Rerun recordings and progress on the terminal: everything that people look at."""

import os

# Rerun's allocator reads this variable as Rerun is imported. By default the allocator keeps memory
# that Rerun has freed, but uses little of it again, so that a visualizer's memory grows.
os.environ.setdefault("MIMALLOC_PURGE_DELAY", "0")
