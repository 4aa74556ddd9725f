# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The folder of a task file, for tests that read or damage it."""

from pathlib import Path

import pytest

from tests.tasks.hopper_file import HOPPER, TASK


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder `hopper` with its model, its reference and its task file."""
    hopper = tmp_path / "hopper"
    hopper.mkdir()
    (hopper / "hopper.xml").write_text(HOPPER)
    (hopper / "reference.csv").write_text("time,com/z\n0,1\n2,3\n")
    (hopper / "task.yaml").write_text(TASK)
    return hopper
