"""Describes the software of a recorded run: versions, commit and machine."""

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import yaml

_PACKAGES = ("vgps_ros", "mujoco", "numpy", "numba", "scipy", "torch", "mcap", "rosbags")
_VARIABLES = (
    "ROS_DISTRO",
    "ROS_DOMAIN_ID",
    "RMW_IMPLEMENTATION",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
)


def environment() -> str:
    """Returns versions, commit and machine as YAML."""
    return yaml.safe_dump(
        {
            "commit": _commit(),
            "python": platform.python_version(),
            "platform": platform.platform(),
            "packages": {name: _version(name) for name in _PACKAGES},
            "variables": {name: os.environ.get(name, "") for name in _VARIABLES},
        },
        sort_keys=False,
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _commit() -> str:
    """Returns the commit of the running source, with "-dirty" if files were changed since."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            cwd=Path(__file__).resolve().parent,
            capture_output=True,
            text=True,
            timeout=5.0,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown: not run from a git checkout"
    return described.stdout.strip()
