# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The command `vgps`: help that comes at once, misspelt words, completion, executables."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vgps_ros import NODES
from vgps_ros.programs.__main__ import COMMANDS, main

ROOT = Path(__file__).parents[2]
INSTALLED = ROOT / "install" / "vgps_ros"
BAG = [f"bag {action}" for action in ("info", "check", "rerun", "table", "reindex")]


HELP = """
import sys
from vgps_ros.programs.__main__ import main

for words in sys.argv[1:]:
    try:
        main([*words.split(), "--help"])
    except SystemExit as stop:
        assert stop.code == 0
slow = {"joblib", "llvmlite", "matplotlib", "mujoco", "numba", "pyarrow", "rclpy", "scipy", "torch"}
assert not slow & sys.modules.keys(), slow & sys.modules.keys()
"""


def test_help_of_every_command_comes_before_anything_that_is_slow_to_import():
    commands = ["", *COMMANDS, *BAG]
    run = [sys.executable, "-c", HELP, *commands]
    answer = subprocess.run(run, capture_output=True, text=True, check=True)
    for command in commands:
        assert f"usage: vgps {command}".rstrip() + " [-h]" in answer.stdout


@pytest.mark.parametrize(
    ("variable", "sentence"),
    [
        ("METHOD=vpgs", "Did you mean 'vgps'?"),
        ("HIDDEN=five", "hidden_units is 'five', but it must be a whole number"),
        ("SEED=-1", "seed is -1, but it must be from 0"),
        ("ITERATIONS=0", "iterations is 0, but it must be from 1"),
    ],
)
def test_a_demo_with_a_wrong_value_is_refused_before_anything_starts(variable, sentence, tmp_path):
    name, _, value = variable.partition("=")
    answer = subprocess.run(
        [ROOT / "scripts" / "run_demo.bash"],
        env={**os.environ, name: value, "OUTPUT": str(tmp_path / "run")},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert answer.returncode != 0
    [line] = answer.stderr.splitlines()
    assert sentence in line
    assert not answer.stdout
    assert not list(tmp_path.iterdir())


def test_an_unknown_variable_of_make_is_refused(tmp_path):
    command = ["make", "-C", str(ROOT), "help", "HIDEN=10"]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode != 0
    assert "There is no variable HIDEN. Did you mean HIDDEN?" in answer.stderr


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["trian"], "Did you mean 'train'?"),
        (["bag", "chek"], "Did you mean 'check'?"),
        (["bag", "info", "--jsn", "."], "Did you mean '--json'?"),
        (["train", "--tsak", "walker"], "--tsak walker. Did you mean '--task'?"),  # nor an --output
        (["node", "simulatoin"], "Did you mean 'simulation'?"),
        (["evaluate", "--rolouts", "3", "."], "Did you mean '--rollouts'?"),
        (["train", "--method", "vpgs", "--output", "x"], "Did you mean 'vgps'?"),
        (["evaluate"], "required: run. See `vgps evaluate --help`"),
        ([], "arguments are required: COMMAND"),
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest(words, sentence, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2
    [line] = capsys.readouterr().err.splitlines()
    assert sentence in line


MODEL = """
<mujoco><size memory="{memory}"/><worldbody><body><joint name="hinge"/><geom size="1"/></body>
</worldbody><actuator><motor joint="hinge"/></actuator></mujoco>
"""
TASK = "model: robot.xml\ncontrol_period: 0.02\nhorizon: 1.0\ncost: [{control: all}]\n"


@pytest.mark.parametrize(("memory", "limit"), [("1G", 2.0), ("1G", 4.0), ("1M", 0.45)])
def test_a_limit_of_memory_ends_a_command_in_a_sentence(memory, limit, tmp_path):
    """Of a model with a large arena, and of the libraries alone."""
    (tmp_path / "robot.xml").write_text(MODEL.format(memory=memory))
    (tmp_path / "task.yaml").write_text(TASK)
    words = f"ulimit -v {int(limit * 2**20)}; exec vgps train --task . --output run"
    answer = subprocess.run(
        words, cwd=tmp_path, check=False, shell=True, capture_output=True, text=True
    )
    assert answer.returncode == 1
    *_, sentence = answer.stderr.splitlines()
    assert "Traceback" not in answer.stderr
    assert "memory" in sentence


def test_a_task_whose_cost_is_of_controls_alone_is_looked_over(tmp_path, capsys):
    (tmp_path / "robot.xml").write_text(MODEL.format(memory="1M"))
    (tmp_path / "task.yaml").write_text(TASK)
    main(["check", str(tmp_path / "task.yaml"), "--seconds", "1"])
    assert "│ controls" in capsys.readouterr().out


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("can't start new thread")])
def test_what_is_short_of_memory_says_so_and_a_fault_is_no_sentence(error, monkeypatch):
    def fail(_):
        raise error

    monkeypatch.setattr("vgps_ros.programs.bag.run", fail)
    with pytest.raises(SystemExit, match="vgps bag info: There is too little memory; close other"):
        main(["bag", "info", "bag"])
    error = RuntimeError("a fault")
    with pytest.raises(RuntimeError, match="a fault"):
        main(["bag", "info", "bag"])


def test_every_command_and_node_is_an_executable_of_the_package_too(tmp_path):
    names = {command.replace("-", "_") for command in COMMANDS} | {*NODES}
    assert {file.name for file in (INSTALLED / "lib" / "vgps_ros").iterdir()} == names
    answer = subprocess.run(
        [str(INSTALLED / "lib" / "vgps_ros" / "execute_policy"), "--help"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert answer.stdout.startswith("usage: vgps execute-policy ")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("vgps ev", {"evaluate"}),
        ("vgps train --alpha", {"--alphas", "--alpha-iterations"}),
        ("vgps train --method weigh", {"weighted_dagger"}),
        ("vgps node s", {"simulation"}),
        ("vgps train --task w", {"walker"}),
        ("vgps bag re", {"rerun", "reindex"}),
    ],
)
def test_the_shell_completes_commands_flags_and_choices(line, words, tmp_path):
    """As bash asks, with the answer on a file in place of descriptor 8."""
    environment = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(tmp_path / "answer"),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    subprocess.run([sys.executable, "-m", "vgps_ros.programs"], env=environment, check=True)
    answer = (tmp_path / "answer").read_text().replace("\013", " ").split()
    assert {word.strip() for word in answer} == words
