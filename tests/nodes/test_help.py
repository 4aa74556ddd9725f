"""`--help` of nodes, in real processes; programs have tests of their own."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.nodes.conftest import EXECUTABLES

OWN = {  # nodes that begin in different ways, with a parameter of each
    "simulation": "real_time_factor",
    "policy_executor": "torque_rate_limit",
    "policy_learner": "alpha_iterations",
    "recorder": "max_file_duration",
    "player": "start_offset",
}


def _ask(name: str, argument: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(EXECUTABLES / name), argument],
        cwd=folder,
        env={**os.environ, "COLUMNS": "200", "ROS_LOG_DIR": str(folder / "log")},
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )


@pytest.mark.parametrize("name", OWN)
def test_a_node_tells_its_parameters_and_begins_nothing(name, tmp_path):
    answer = _ask(name, "--help", tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert f"ros2 run vgps_ros {name}" in answer.stdout
    names = [line.split()[0] for line in answer.stdout.splitlines() if line.strip()]
    assert {OWN[name], "wait_timeout"} <= {part.rpartition(".")[2] for part in names}
    assert "s] (from 2.5 to 3600)" in answer.stdout  # of peer_timeout: unit and range
    assert not [file for file in tmp_path.iterdir() if file.name != "log"]


def test_an_argument_that_no_node_takes_is_refused(tmp_path):
    answer = _ask("recorder", "--output", tmp_path)
    assert answer.returncode == 1
    assert "recorder does not know the argument '--output'" in answer.stderr
    assert "--ros-args -p" in answer.stderr
    assert not [file for file in tmp_path.iterdir() if file.name != "log"]
