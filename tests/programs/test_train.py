# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `train`: what it writes, and what it refuses."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.search.metrics import METRICS
from vgps_ros.storage.run_folder import load_distributions, load_policy

QUICK = ["--iterations", "2", "--initial-ddp-iterations", "2", "--evaluation-rollouts", "2"]


def main(arguments):
    vgps(["train", *arguments])


def test_it_writes_the_result_and_a_policy_that_loads_again(tmp_path, capsys):
    main([*QUICK, "--seed", "4", "--hidden-units", "3", "2", "--output", str(tmp_path / "run")])
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert result["task"] == "swimmer"
    assert result["method"] == "vgps"
    assert result["seed"] == 4
    assert result["hidden_units"] == [3, 2]
    assert result["num_parameters"] == (9 * 3 + 3) + (3 * 2 + 2) + (2 * 2 + 2)
    assert [entry["k"] for entry in result["iterations"]] == [1, 2]
    assert set(result["iterations"][0]) == {"k", *METRICS}
    policy, task = load_policy(tmp_path / "run" / "policy.json")
    assert task == "swimmer"
    assert policy.mean(np.zeros(9)).shape == (2,)
    assert (tmp_path / "run" / "learning_curve.png").read_bytes().startswith(b"\x89PNG")
    with np.load(tmp_path / "run" / "trajectories.npz", allow_pickle=False) as arrays:
        shapes = {name: arrays[name].shape for name in arrays}
    assert shapes == {
        "initial_states": (501, 10),
        "mean_states": (501, 10),
        "state_covariances": (501, 10, 10),
        "executed_states": (501, 10),
    }
    [q], task = load_distributions(tmp_path / "run" / "distribution.npz")
    assert task == "swimmer"
    assert q.mean.horizon == 500
    with np.load(tmp_path / "run" / "trajectories.npz", allow_pickle=False) as arrays:
        np.testing.assert_array_equal(q.state_covariances, arrays["state_covariances"])
    # A table with one line an iteration, for a person to follow.
    header, *lines = capsys.readouterr().out.splitlines()[:3]
    assert header.split()[:4] == ["iteration", "alpha", "stochastic", "deterministic"]
    last = result["iterations"][-1]
    figures = (last["stochastic_cost_mean"], last["deterministic_cost"], last["ddp_cost"])
    assert lines[1].split()[:5] == ["2/2", "20.00", *(f"{cost:.1f}" for cost in figures)]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--task", "swimer"], "There is no task 'swimer'; name one of"),
        (["--sed", "3"], "unrecognized arguments: --sed 3. Did you mean '--seed'?"),
        (["--seeds=3"], "Did you mean '--seed'?"),
        (["--iterations", "0"], "iterations is 0, but it must be from 1"),
        (["--alphas", "1", "-0.1"], "alphas is -0.1, but it must be from"),
        (["--alphas", "nan", "1"], "alphas is nan"),
        (["--alphas", "1", "--alpha-iterations", "0", "50"], "alphas has 1 values, but"),
        (
            ["--preset", "paper", "--alphas=5"],
            "but the preset paper sets it to (1.0, 0.1): leave out",
        ),
        (["--ddp-regularization-floor", "1e11"], "but it must be from 0 to 1e+10"),
        (["--hidden-units", "5", "0"], "hidden_units is 0"),
        (["--seed", "-1"], "seed is -1"),
        (["--method", "vpgs"], "Did you mean 'vgps'?"),
        (["--hidden-units", "many"], "hidden_units is 'many', but it must be a whole number from"),
        (["--iterations", "1_0"], "iterations is '1_0', but it must be a whole number from 1 to"),
        (["--iterations", "\u0663"], "but it must be a whole number"),
        (["--alphas", "1_0"], "alphas is '1_0', but it must be a number from 1e-09 to"),
        (["--check", "--disturb-body", "hed", "--disturb-push", "1"], "there is no body 'hed'"),
    ],
)
def test_bad_input_is_refused_with_a_sentence_and_nothing_is_written(
    tmp_path, capsys, arguments, sentence
):
    with pytest.raises(SystemExit) as exit_info:
        main([*arguments, "--output", str(tmp_path / "run")])
    assert exit_info.value.code != 0
    assert sentence in str(exit_info.value.code) + capsys.readouterr().err
    assert not list(tmp_path.rglob("*.json"))


def test_a_folder_where_another_training_writes_is_refused(tmp_path):
    other = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(other, fcntl.LOCK_EX)
    with pytest.raises(SystemExit, match="Another training writes to"):
        main(["--task", "rotor", "--iterations", "1", "--output", str(tmp_path)])
    os.close(other)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("file", ["policy.json", "learning_curve.png"])
def test_a_full_disk_ends_it_in_a_sentence(tmp_path, file):
    (tmp_path / f"{file}.part").symlink_to("/dev/full")
    (tmp_path / file).symlink_to("/dev/full")
    with pytest.raises(SystemExit, match=r"The disk is full; free some space, and give the same"):
        main(["--task", "rotor", "--iterations", "1", "--output", str(tmp_path)])


def test_a_finished_run_is_replaced_only_where_that_is_asked_for(tmp_path):
    rotor = ["--task", "rotor", "--iterations", "1", "--output", str(tmp_path / "run")]
    main([*rotor, "--check"])
    assert not (tmp_path / "run").exists()
    main(rotor)
    result = (tmp_path / "run" / "result.json").read_bytes()
    for flag in ("--check", "--seed=1"):
        with pytest.raises(SystemExit, match=r"result\.json' exists already; .* give --overwrite"):
            main([*rotor, flag])
    assert (tmp_path / "run" / "result.json").read_bytes() == result
    main([*rotor, "--seed", "1", "--overwrite"])
    assert json.loads((tmp_path / "run" / "result.json").read_text())["seed"] == 1


def test_a_training_begins_with_the_policy_of_another_one(tmp_path):
    def train(name, *more):
        output = tmp_path / name
        main(["--task", "rotor", "--iterations", "1", *more, "--output", str(output)])
        found = json.loads((output / "result.json").read_text())
        return found["iterations"][0]["deterministic_cost"], found["initial_ddp_cost"]

    _, optimum = train("first", "--iterations", "6")
    short = ("--seed", "2", "--fit-iterations", "1")
    drawn, _ = train("drawn", *short)
    begun, _ = train("begun", *short, "--from", str(tmp_path / "first"))
    assert begun - optimum < 0.5 * (drawn - optimum)
    with pytest.raises(
        SystemExit, match=r"begin with has hidden_units \(\d+,\), but this training"
    ):
        train("other", "--hidden-units", "2", "--from", str(tmp_path / "first"))
    with pytest.raises(SystemExit, match=r"none/policy\.json is not a readable policy file"):
        train("none", "--from", str(tmp_path / "none"))


def test_help_tells_what_each_setting_does_and_its_range(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "exponential between them, then constant; from 1e-09 to 1e+09; default 0.3 20.0" in text
    assert "seed of all random draws; from 0 to 4611686018427387904; default 0" in text
    with pytest.raises(SystemExit):
        main(["--task", "walker", "--help"])
    walker = " ".join(capsys.readouterr().out.split())
    option = "DDP iterations of the initial solve (line 1); from 1 to 100000; default "
    assert f"{option}80" in text
    assert f"{option}45" in walker


ROTOR = ["--task", "rotor", "--hidden-units", "3", "--evaluation-rollouts", "4"]


def start(*arguments):
    command = [sys.executable, "-m", "vgps_ros.programs", "train", *ROTOR, *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def outcome(folder):
    """All that a training leaves but wall times and the picture."""
    result = json.loads((folder / "result.json").read_text())
    for entry in result["iterations"]:
        del entry["q_step_seconds"], entry["m_step_seconds"]
    with np.load(folder / "trajectories.npz") as file:
        arrays = {name: file[name].tobytes() for name in file.files}
    return result, arrays, (folder / "policy.json").read_bytes()


@pytest.mark.slow
def test_killed_at_random_moments_it_goes_on_and_leaves_the_same_bytes(tmp_path, rng):
    arguments = ["--method", "adaptive_gps", "--iterations", "25", "--seed", "6", "--output"]
    main([*ROTOR, *arguments, str(tmp_path / "undisturbed")])

    kept = tmp_path / "killed" / "checkpoints"
    for _ in range(3):
        before = {path.stat().st_mtime_ns for path in kept.glob("*.npz")}
        program = start(*arguments, str(tmp_path / "killed"))
        while {path.stat().st_mtime_ns for path in kept.glob("*.npz")} <= before:
            assert program.poll() is None, program.communicate()
            time.sleep(0.005)
        time.sleep(rng.uniform(0.0, 0.3))
        program.kill()
        program.communicate()
        assert program.returncode == -signal.SIGKILL
        assert not (tmp_path / "killed" / "trajectories.npz").exists()
    program = start(*arguments, str(tmp_path / "killed"))
    output, _ = program.communicate(timeout=120)
    assert program.returncode == 0, output
    assert " of 25." in output.splitlines()[0]
    assert output.startswith("Going on from iteration ")
    assert outcome(tmp_path / "killed") == outcome(tmp_path / "undisturbed")
    names = {path.name for path in (tmp_path / "undisturbed").iterdir()}
    assert {path.name for path in (tmp_path / "killed").iterdir()} == names
    assert "checkpoints" not in names


def test_another_training_in_the_folder_of_one_that_has_not_ended_is_refused(tmp_path):
    program = start("--iterations", "10000", "--output", str(tmp_path / "run"))
    while len(list((tmp_path / "run").glob("checkpoints/*.npz"))) < 2:
        assert program.poll() is None, program.communicate()
        time.sleep(0.05)
    program.send_signal(signal.SIGINT)
    output, _ = program.communicate(timeout=60)
    assert program.returncode == 1
    assert "the same command goes on after the last whole iteration" in output
    assert not list((tmp_path / "run" / "checkpoints").glob("*.part"))
    with pytest.raises(SystemExit, match="with seed 0, but this one has seed 1; name another"):
        main([*ROTOR, "--seed", "1", "--iterations", "10000", "--output", str(tmp_path / "run")])
