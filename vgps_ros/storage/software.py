# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Describes what the bytes of a run depend on: versions, commit, machine and its arithmetic.

The controls of an executed policy do not depend on the machine (see `robot/executed_control`). The
bytes of a training do: BLAS, the compiler of the loops, torch and libm choose their code by what
the processor can do, and their sums differ in the last bits. An optimisation enlarges that from
step to step, so only trainings with equal `arithmetic` and `packages` have equal bytes.
"""

import ctypes
import os
import platform
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import yaml

_PACKAGES = ("vgps_ros", "mujoco", "numpy", "numba", "scipy", "torch", "mcap", "rosbags")
_VARIABLES = (
    "ROS_DISTRO",
    "ROS_DOMAIN_ID",
    "RMW_IMPLEMENTATION",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OPENBLAS_CORETYPE",
    "NUMBA_CPU_NAME",
    "MKL_ENABLE_INSTRUCTIONS",
)
# The function of OpenBLAS that names its kernel, and its name in the wheels of NumPy and SciPy.
_KERNEL_NAMES = ("openblas_get_corename", "scipy_openblas_get_corename")


def environment() -> str:
    """Returns versions, commit and machine as YAML."""
    return yaml.safe_dump(
        {
            "commit": commit(),
            "python": platform.python_version(),
            "platform": platform.platform(),
            "arithmetic": arithmetic(),
            "packages": {name: _version(name) for name in _PACKAGES},
            "variables": {name: os.environ.get(name, "") for name in _VARIABLES},
        },
        sort_keys=False,
    )


def versions() -> dict[str, str]:
    """Returns what the bits of a solve depend on but the machine, by name."""
    return {**{name: _version(name) for name in _PACKAGES[:5]}, "commit": commit()}


def arithmetic() -> dict[str, Any]:
    """Returns what chooses the last bits of a computation on this machine, by name."""
    found: Any = np.show_config(mode="dicts")
    torch = sys.modules.get("torch")  # a process that has not loaded it does not compute with it
    return {
        "processor": llvm.get_host_cpu_name(),
        "features": found["SIMD Extensions"]["found"],
        "blas": f"{found['Build Dependencies']['blas']['name']} "
        f"{found['Build Dependencies']['blas']['version']}",
        "blas_kernels": _blas_kernels(),
        "torch": torch.backends.cpu.get_cpu_capability() if torch else "not loaded",
        "libc": " ".join(platform.libc_ver()),
    }


def _blas_kernels() -> list[str]:
    """Returns the kernels of the OpenBLAS libraries that this process has loaded."""
    maps = Path("/proc/self/maps")
    # A path ends its line, and may have blanks.
    paths = set(re.findall(r"/.*openblas.*", maps.read_text() if maps.is_file() else ""))
    kernels = set()
    for library in map(ctypes.CDLL, sorted(paths)):
        for name in (f"{base}{suffix}" for base in _KERNEL_NAMES for suffix in ("", "64_")):
            if function := getattr(library, name, None):
                function.restype = ctypes.c_char_p
                kernels.add(function().decode())
    return sorted(kernels)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def commit() -> str:
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
