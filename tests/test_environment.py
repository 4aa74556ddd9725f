# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""env.bash in real shells."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OF_WHEELS = not (ROOT / ".venv" / "ros_setup").exists()


def shell(commands, **variables):
    words = ["bash", "-euc", commands]
    environment = {"PATH": os.environ["PATH"], "HOME": os.environ["HOME"], **variables}
    return subprocess.run(
        words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )


def test_sourcing_it_twice_changes_nothing_and_tells_the_distribution():
    show = "echo $ROS_DISTRO; printenv | grep -E '^(PATH|AMENT|CMAKE|PYTHON|LD_)' | sort"
    once = shell(f"source env.bash; {show}")
    twice = shell(f"source env.bash; source env.bash; {show}")
    assert once.returncode == 0, once.stderr
    assert once.stdout.startswith("jazzy\n")
    (words, again) = (text.replace("\n", ":").split(":") for text in (once.stdout, twice.stdout))
    assert sorted(again) == sorted(words)  # colcon's scripts may put their own folders first
    assert not twice.stderr


@pytest.mark.skipif(not OF_WHEELS, reason="this checkout uses an installation of ROS")
def test_an_installation_that_the_checkout_was_not_set_up_with_is_refused():
    answer = shell("source env.bash", ROS_VERSION="2", ROS_DISTRO="rolling")
    assert answer.returncode == 1
    assert "set up without the ROS 2 'rolling' sourced here" in answer.stderr
