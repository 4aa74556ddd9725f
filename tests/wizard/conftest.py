# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What all tests of first tasks share."""

import pytest

from vgps_ros.programs.__main__ import main
from vgps_ros.tasks import make_task


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Returns a function that writes a task for a model, and returns its text and the task."""
    monkeypatch.chdir(tmp_path)

    def write(model):
        (tmp_path / "robot.xml").write_text(model)
        main(["new", "mine", "--model", "robot.xml", "--overwrite"])
        return (tmp_path / "mine" / "task.yaml").read_text(), make_task("mine")

    return write
