# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Counts the cores of this machine that a process may use."""

import os


def count_cores() -> int:
    """Returns how many cores this process may use, at least 1."""
    if hasattr(os, "sched_getaffinity"):  # of Linux alone
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
