"""The command `vgps`: help that comes at once, misspelt words, completion, executables."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from vgps_ros import NODES
from vgps_ros.programs.__main__ import COMMANDS, main

ROOT = Path(__file__).parents[2]
INSTALLED = ROOT / "install" / "vgps_ros"
BAG = [f"bag {action}" for action in ("info", "check", "rerun", "table", "reindex")]


@pytest.mark.parametrize("words", ["", *COMMANDS, *BAG])
def test_help_takes_less_than_half_a_second_of_processor_time(words):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [str(INSTALLED / "bin" / "vgps"), *words.split(), "--help"]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert answer.stdout.startswith(f"usage: vgps {words}".rstrip())
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.5


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["trian"], "Did you mean 'train'?"),
        (["bag", "chek"], "Did you mean 'check'?"),
        (["bag", "info", "--jsn", "."], "Did you mean '--json'?"),
        (["node", "simulatoin"], "Did you mean 'simulation'?"),
        (["evaluate", "--rolouts", "3", "."], "Did you mean '--rollouts'?"),
        (["figure", ".", "--average", "medain"], "Did you mean 'median'?"),
        (["evaluate"], "name the folder of a run"),
        ([], "arguments are required: COMMAND"),
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest(words, sentence, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2
    [line] = capsys.readouterr().err.splitlines()
    assert sentence in line


def test_every_command_and_node_is_an_executable_of_the_package_too(tmp_path):
    names = {command.replace("-", "_") for command in COMMANDS} - {"node"} | {*NODES}
    assert {file.name for file in (INSTALLED / "lib" / "vgps_ros").iterdir()} == names
    answer = subprocess.run(
        [str(INSTALLED / "lib" / "vgps_ros" / "find_gait"), "--help"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert answer.stdout.startswith("usage: vgps find-gait ")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("vgps ev", {"evaluate"}),
        ("vgps train --alpha", {"--alphas", "--alpha-iterations"}),
        ("vgps train --method weigh", {"weighted_dagger"}),
        ("vgps node s", {"simulation"}),
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
