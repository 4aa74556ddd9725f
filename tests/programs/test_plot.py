# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `plot`: pictures of the shipped bag, and of a run of `train`."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.bags.altered import copy, time_of_state, without
from vgps_ros.bags import BagReader
from vgps_ros.bags.run_reader import read_run
from vgps_ros.messages.conversions import distribution_from_msg
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.search.run_record import read_results
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.views import filmstrip

DRAWN = ("learning_curve", "trajectory", "motion")
SAMPLE = Path(__file__).parents[2] / "recordings" / "sample"


@pytest.fixture
def no_rendering(monkeypatch):
    """Rendering takes seconds; its own tests do it."""

    def fail(*_):
        raise filmstrip.RenderingError("MuJoCo cannot draw here.")

    monkeypatch.setattr(filmstrip, "filmstrip", fail)
    monkeypatch.setattr(filmstrip, "write_moving_picture", fail)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    quick = ["--iterations", "2", "--initial-ddp-iterations", "2", "--evaluation-rollouts", "2"]
    vgps(["train", *quick, "--hidden-units", "2", "--output", str(folder)])
    return folder


def fails(arguments, sentence):
    with pytest.raises(SystemExit) as stop:
        vgps(["plot", *map(str, arguments)])
    assert sentence in str(stop.value.code)


def test_what_is_missing_is_named(tmp_path, capsys, no_rendering):
    bag = without(tmp_path / "bag", "/joint_states", range(200, 250))
    vgps(["plot", str(bag)])
    assert f"Not whole: 50 states from {time_of_state(199):.3f}" in capsys.readouterr().out


def test_a_bag_gives_the_costs_the_last_q_and_the_last_episode():
    run = read_run(SAMPLE)
    with BagReader(SAMPLE) as bag:
        progress = [bag.decode(m) for m in bag.messages(["/learning_progress"])]
        solutions = [bag.decode(m) for m in bag.messages(["/trajectory_distribution"])]
        first, *_ = [bag.decode(m) for m in bag.messages(["/joint_states"])]
    assert [e["k"] for e in run.result["iterations"]] == [p.iteration for p in progress]
    assert run.result["iterations"][-1]["deterministic_cost"] == progress[-1].deterministic_cost
    assert run.result["hidden_units"] == [5]
    last = distribution_from_msg(solutions[-1])
    np.testing.assert_array_equal(run.mean_states, last.mean.states)
    np.testing.assert_array_equal(run.state_covariances, last.state_covariances)
    initial = distribution_from_msg(solutions[0])
    np.testing.assert_array_equal(run.initial_states, initial.mean.states)
    assert run.executed_states.shape == (501, 10)
    np.testing.assert_array_equal(run.executed_states[0, :5], first.position)
    assert run.time_step == 0.02


def test_a_trained_run_gives_the_same_kind_of_record(trained):
    run = read_results(RunFolder(trained))
    assert run.result == json.loads((trained / "result.json").read_text())
    assert run.executed_states.shape == run.mean_states.shape == (501, 10)


def test_what_can_be_drawn_is_written_and_never_overwritten(
    no_rendering, trained, tmp_path, capsys
):
    vgps(["plot", str(trained), "--output", str(tmp_path)])
    names = {f"{n}.{f}" for n in DRAWN for f in ("png", "svg")}
    assert {file.name for file in tmp_path.iterdir()} == names
    assert "No filmstrip: MuJoCo cannot draw here." in capsys.readouterr().out
    before = (tmp_path / "motion.png").stat().st_mtime_ns
    fails([trained, "--output", tmp_path], "exists already")
    assert (tmp_path / "motion.png").stat().st_mtime_ns == before
    vgps(["plot", str(trained), "--output", str(tmp_path), "--overwrite"])


def test_a_bag_without_joint_states_still_shows_the_training(no_rendering, tmp_path, capsys):
    copy(tmp_path / "bag", lambda m: None if m.topic == "/joint_states" else m.data)
    vgps(["plot", str(tmp_path / "bag"), "--output", str(tmp_path / "plots")])
    assert "there are no joint_states under a policy" in capsys.readouterr().out
    assert not (tmp_path / "plots" / "motion.png").exists()
    assert (tmp_path / "plots" / "learning_curve.svg").exists()


def test_what_is_no_run_is_refused_with_a_sentence(trained, tmp_path):
    fails([tmp_path], "is not a bag")
    fails([tmp_path / "nothing"], "is not a bag")
    (tmp_path / "result.json").write_text("{}")
    fails([tmp_path], "has costs but no motion")
    shutil.copy(trained / "trajectories.npz", tmp_path)
    fails([tmp_path], "does not hold what `train` writes")
    shutil.copy(trained / "result.json", tmp_path)
    whole = (trained / "trajectories.npz").read_bytes()
    for broken in (b"PK", whole[: len(whole) // 2]):
        (tmp_path / "trajectories.npz").write_bytes(broken)
        fails([tmp_path], "does not hold what `train` writes")
    wrong = np.zeros((3, 4))
    np.savez(
        tmp_path / "trajectories.npz",
        initial_states=wrong, mean_states=wrong, executed_states=wrong,
        state_covariances=np.zeros((3, 10, 10)),
    )  # fmt: skip
    fails([tmp_path], "initial_states has 12 values")
    assert not (tmp_path / "plots").exists()
