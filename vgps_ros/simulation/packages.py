# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds the folders of packages, by which models and their meshes are named."""

import importlib.util
import os
from pathlib import Path


def package_folders(name: str) -> list[Path]:
    """Returns the folders of a Python package and of a ROS package of this name."""
    try:
        found = importlib.util.find_spec(name)
    except (ImportError, ValueError):  # of modules that are half there
        found = None
    python = (found.submodule_search_locations if found else None) or []
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    shared = [Path(prefix) / "share" / name for prefix in prefixes]
    return [folder for folder in (*map(Path, python), *shared) if folder.is_dir()]
