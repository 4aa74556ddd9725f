# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Whoever waits for the compiler is told so."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
from vgps_ros.search.trajectory_optimization import prepare
from vgps_ros.tasks import make_task
prepare(make_task("swimmer"))
"""


def output(**environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_new_machine_is_compiled_for_once_and_told(tmp_path):
    assert "Compiling" in output(NUMBA_CACHE_DIR=str(tmp_path))
    assert any(tmp_path.rglob("*.nbc"))
