# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Variational guided policy search on ROS 2."""

from pkgutil import iter_modules

__version__ = "1.0.0"

# The environment variable in which programs keep what the user's MUJOCO_GL says.
DRAWS_BY = "VGPS_MUJOCO_GL"

# Names of the nodes, which are modules or folders, executables, and blocks of a parameter file.
NODES = sorted(module.name for module in iter_modules([f"{path}/nodes" for path in __path__]))
