# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""`train --tensorboard`: what TensorBoard's own reader finds in the files of tensorboardX."""

import json
import sys

import pytest

from vgps_ros.programs.__main__ import main as vgps

reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
QUICK = ["--task", "rotor", "--initial-ddp-iterations", "2", "--evaluation-rollouts", "2"]


def scalars(folder):
    events = reader.EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    tags = events.Tags()["scalars"]
    return {tag: {e.step: e.value for e in events.Scalars(tag)} for tag in tags}


def entries(folder):
    return json.loads((folder / "result.json").read_text())["iterations"]


def test_each_metric_of_each_iteration_is_there(tmp_path):
    vgps(["train", *QUICK, "--iterations", "3", "--tensorboard", "--output", str(tmp_path)])
    found = scalars(tmp_path)
    for entry in entries(tmp_path):
        for name, value in entry.items():
            values = (
                {f"{name}/{i}": v for i, v in enumerate(value)}
                if isinstance(value, list)
                else {name: value}
            )
            for tag, number in values.items():
                if tag in ("k", "policy_digest") or number is None:
                    assert entry["k"] not in found.get(tag, {})
                else:
                    assert found[tag][entry["k"]] == pytest.approx(number, rel=1e-6)
    assert sorted(found["deterministic_cost"]) == [1, 2, 3]


def test_a_training_anew_takes_the_place_of_the_one_before(tmp_path):
    for seed in ("0", "1"):
        arguments = ["--iterations", "2", "--seed", seed, "--tensorboard", "--overwrite"]
        vgps(["train", *QUICK, *arguments, "--output", str(tmp_path)])
    found = scalars(tmp_path)["deterministic_cost"]
    assert [found[k] for k in (1, 2)] == pytest.approx(
        [entry["deterministic_cost"] for entry in entries(tmp_path)], rel=1e-6
    )


def test_without_the_flag_there_is_no_such_folder(tmp_path):
    vgps(["train", *QUICK, "--iterations", "1", "--output", str(tmp_path)])
    assert not (tmp_path / "tensorboard").exists()


def test_without_the_package_it_says_what_installs_it_and_trains_nothing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(SystemExit, match=r"pip install -r requirements/tensorboard\.txt\."):
        vgps(["train", *QUICK, "--tensorboard", "--output", str(tmp_path / "run")])
    assert not (tmp_path / "run").exists()
