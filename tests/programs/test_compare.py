# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `compare`: figures over training seeds, and the falls of one of a pair."""

import json

import numpy as np
import pytest
from PIL import Image

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.search.seed_statistics import interquartile_mean
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.tasks import make_task
from vgps_ros.tasks.registry import task_file_of

ROLLOUTS = ["--seconds", "1", "--rollouts", "3"]


def write_run(folder, name, seed, control=0.0):
    """Writes a run whose policy always gives the same control."""
    task = make_task(name)
    shape = Architecture(task.observation.names, (), task.dynamics.control_dim)
    parameters = np.zeros(shape.num_parameters)
    parameters[-shape.control_dim :] = control
    policy = GaussianPolicy(shape, parameters, np.ones(shape.control_dim))
    result = {"task": name, "seed": seed, "initial_ddp_cost": 1.0, "iterations": [{"k": 1}]}
    RunFolder(folder).save(result, policy)


@pytest.fixture
def compared(tmp_path, capsys):
    def run(*arguments):
        vgps(["compare", *arguments, "--json", str(tmp_path / "c.json"), "--overwrite"])
        return json.loads((tmp_path / "c.json").read_text()), capsys.readouterr().out

    return run


def test_a_training_counts_once_and_pairs_share_a_seed(tmp_path, compared, capsys):
    for side, seeds in (("a", (1, 2, 3)), ("b", (2, 3, 4))):
        for seed in seeds:
            control = 0.1 * seed if side == "a" else 0.4 + 0.1 * seed
            write_run(tmp_path / f"{side}-{seed}", "swimmer", seed, control)
    glob = str(tmp_path / "a-*")
    names = ",".join(str(tmp_path / f"b-{seed}") for seed in (2, 3, 4))
    found, shown = compared(glob, names, *ROLLOUTS)
    assert found["pairs"] == [[1, 0], [2, 1]]
    (row,) = (row for row in found["figures"] if row["figure"] == "cost per step")
    vgps(["evaluate", str(tmp_path / "a-2"), *ROLLOUTS, "--json", "-"])
    assert row["values"][0][1] == json.loads(capsys.readouterr().out)["cost_per_step"]["median"]
    a, b = map(np.array, row["values"])
    assert row["A"][0] == pytest.approx(interquartile_mean(a))
    assert row["A less B"][0] == pytest.approx(np.mean(a[1:] - b[:2]))
    assert row["A"][1] <= row["A"][0] <= row["A"][2]
    better = np.mean(a[:, None] < b) + 0.5 * np.mean(a[:, None] == b)
    assert row["A better"][0] == pytest.approx(better)
    assert "3 and 3 trainings" in shown
    # The same ones are alike, and one training alone has no interval.
    alike, shown = compared(str(tmp_path / "a-1"), str(tmp_path / "a-1"), *ROLLOUTS)
    assert all(row["A better"][0] == 0.5 for row in alike["figures"])
    assert " to " not in shown.partition("cost per step")[2].partition("\n")[0]


def test_a_fall_of_one_of_a_pair_is_counted_and_drawn(tmp_path, compared):
    write_run(tmp_path / "falls", "quadruped", 0, control=-3.0)
    names = [str(task_file_of("quadruped").parent / "policy.json"), str(tmp_path / "falls")]
    flags = ["--seconds", "3", "--rollouts", "2", "--pushes", "1"]
    found, shown = compared(*names, *flags, "--fall", str(tmp_path / "fall.gif"))
    falls = found["falls_of_one"]
    assert {(fall["fell"], fall["kind"], fall["value"]) for fall in falls} == {("B", "pushes", 1.0)}
    assert f"A alone fell in 0, B in {len(falls)}" in shown
    with Image.open(tmp_path / "fall.gif") as picture:
        assert picture.width == 2 * 360
        assert picture.n_frames > 20
    with pytest.raises(SystemExit, match="No policy fell where its pair did not"):
        compared(names[0], names[0], *flags, "--fall", str(tmp_path / "none.gif"))
