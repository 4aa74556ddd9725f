# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""`--help` of nodes, in real processes; programs have tests of their own."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.nodes.conftest import EXECUTABLES

OWN = {  # nodes that begin in different ways, with a parameter of each
    "simulation": "real_time_factor",
    "policy_learner": "alpha_iterations",
    "recorder": "max_file_duration",
    "player": "start_offset",
}


def _ask(name: str, argument: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(EXECUTABLES / name), *argument.split()],
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
    assert "s] (from 0.1 to 86400)" in answer.stdout  # of wait_timeout: unit and range
    assert not [file for file in tmp_path.iterdir() if file.name != "log"]


def test_an_argument_that_no_node_takes_is_refused(tmp_path):
    answer = _ask("recorder", "--output", tmp_path)
    assert answer.returncode == 1
    assert "recorder does not know the argument '--output'" in answer.stderr
    assert "--ros-args -p" in answer.stderr
    assert not [file for file in tmp_path.iterdir() if file.name != "log"]


FILES = {
    "nested.yaml": "ns: {policy_learner: {ros__parameters: {fit: {laet: 0.1}}}}",
    "malformed.yaml": "policy_learner: [",
}


@pytest.mark.parametrize(
    ("name", "arguments", "sentence"),
    [
        (
            "simulation",
            "-p tsak:=walker",
            "simulation has no parameter 'tsak'. Did you mean 'task'?",
        ),
        (
            "recorder",
            "-r __node:=r -p r:otput:=x",
            "r has no parameter 'otput'. Did you mean 'output'?",
        ),
        ("policy_learner", "--params-file nested.yaml", "'fit.laet'. Did you mean 'fit.late'?"),
        ("policy_learner", "--params-file malformed.yaml", "Couldn't parse params file"),
        ("policy_executor", "-p safe_action:=zeros", "Did you mean 'zero'?"),
        ("policy_learner", "-p optimizers:=[my-own]", "'my-own', which is no name in ROS"),
    ],
)
def test_what_no_node_takes_is_refused_in_one_sentence(name, arguments, sentence, tmp_path):
    for file, text in FILES.items():
        (tmp_path / file).write_text(text)
    answer = _ask(name, f"--ros-args {arguments}", tmp_path)
    assert answer.returncode == 1
    assert sentence in answer.stderr
    assert "Traceback" not in answer.stderr
    assert {file.name for file in tmp_path.iterdir()} <= {*FILES, "log"}


def test_a_block_for_all_nodes_may_have_parameters_of_other_nodes(graph, tmp_path):
    file = tmp_path / "all.yaml"
    file.write_text("/**: {ros__parameters: {alphas: [1.0], use_sim_time: false, task: rotor}}")
    node = graph.start("simulation", "--ros-args", "--params-file", str(file))
    graph.spin_until_output(node, "Waiting for joint_command")
