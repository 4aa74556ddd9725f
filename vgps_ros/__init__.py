# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Variational guided policy search on ROS 2."""

from pathlib import Path

__version__ = "1.0.0"

# Names of the nodes, which are modules, executables and blocks of a parameter file alike.
NODES = sorted(file.stem for file in (Path(__file__).parent / "nodes").glob("[!_]*.py"))
