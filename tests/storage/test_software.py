# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What is told of the software and the machine is what they are."""

import os
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import yaml

from vgps_ros.storage import software

ROOT = Path(__file__).parents[2]


def test_versions_commit_and_variables_are_those_of_this_process(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "117")
    monkeypatch.delenv("NUMBA_CPU_NAME", raising=False)
    monkeypatch.setattr(software, "_PACKAGES", ("numpy", "no-such-package"))
    told = yaml.safe_load(software.environment())
    assert told["python"] == ".".join(map(str, sys.version_info[:3]))
    assert told["packages"] == {"numpy": version("numpy"), "no-such-package": "not installed"}
    assert told["variables"]["ROS_DOMAIN_ID"] == "117"
    assert told["variables"]["NUMBA_CPU_NAME"] == ""
    assert told["commit"] == software.commit()
    assert told["arithmetic"] == software.arithmetic()


def test_the_processors_features_are_those_that_the_kernel_names():
    told = software.arithmetic()
    if platform.machine() == "x86_64" and Path("/proc/cpuinfo").is_file():
        flags = Path("/proc/cpuinfo").read_text().split()
        of_avx2 = {"AVX2", "X86_V3"}  # its name in NumPy before 2.4, and since
        assert bool(of_avx2 & set(told["features"])) == ("avx2" in flags)
    assert told["libc"].split() == [word for word in platform.libc_ver() if word]
    assert told["torch"] == "not loaded" or "torch" in sys.modules


def test_the_kernels_of_blas_are_those_that_it_was_told_to_use():
    """OPENBLAS_CORETYPE names one that every 64-bit processor of Intel and AMD has."""
    code = "import numpy; from vgps_ros.storage import software; print(software._blas_kernels())"
    told = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "OPENBLAS_CORETYPE": "Nehalem"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    is_openblas = "openblas" in np.show_config(mode="dicts")["Build Dependencies"]["blas"]["name"]
    if is_openblas and platform.machine() == "x86_64":
        assert told.stdout == "['Nehalem']\n"


def test_a_changed_file_makes_the_commit_dirty(tmp_path, monkeypatch):
    monkeypatch.setattr(software, "__file__", str(tmp_path / "module.py"))
    # The tests' temporary folder may itself lie in a checkout.
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert software.commit() == "unknown: not run from a git checkout"

    def git(*words):
        identity = ("-c", "user.name=Name", "-c", "user.email=name@example.org")
        done = subprocess.run(
            ["git", *identity, *words], cwd=tmp_path, check=True, capture_output=True, text=True
        )
        return done.stdout.strip()

    git("init", "-q")
    (tmp_path / "module.py").write_text("one")
    git("add", ".")
    git("commit", "-qm", "first")
    assert software.commit() == git("rev-parse", "HEAD")
    (tmp_path / "module.py").write_text("two")
    assert software.commit() == git("rev-parse", "HEAD") + "-dirty"
