# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The figure and the summary of an experiment."""

import json
import math
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from benchmarks.figure1.__main__ import main as figure1
from benchmarks.figure1.cells import Panel
from benchmarks.figure1.statistics import CEILING, summary
from benchmarks.figure1.table import write_table

pytestmark = pytest.mark.slow


def main(arguments):
    figure1(["plot", *arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A finished experiment of two methods and two seeds."""
    output = tmp_path_factory.mktemp("experiment")
    figure1(
        [
            "run",
            *("--panels", "rotor-2", "rotor-3", "--methods", "vgps", "cost_weighted"),
            *("--seeds", "2", "--iterations", "2", "--evaluation-rollouts", "2", "--jobs", "1"),
            *("--output", str(output)),
        ]
    )
    return output


def test_it_draws_and_sums_up(folder, tmp_path, capsys):
    main([str(folder), "--output", str(tmp_path / "out")])
    printed = capsys.readouterr().out
    assert "rotor-2" in printed
    assert "cost_weighted" in printed
    assert (tmp_path / "out" / "figure1.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "out" / "figure1.svg").read_bytes()
    assert (tmp_path / "out" / "figure1.rrd").read_bytes().startswith(b"RRF")
    assert (tmp_path / "out" / "profiles.png").read_bytes().startswith(b"\x89PNG")
    lines = (tmp_path / "out" / "summary.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * 2
    (row,) = pa.csv.read_csv(tmp_path / "out" / "improvement.csv").to_pylist()
    assert (row["ours"], row["against"]) == ("vgps", "cost_weighted")
    assert row["stochastic_low"] <= row["stochastic"] <= row["stochastic_high"]


def test_a_table_of_an_older_version_lacks_a_metric_and_is_drawn(folder, tmp_path):
    older = shutil.copytree(folder, tmp_path / "older")
    table = pa.parquet.read_table(older / "results.parquet")
    pa.parquet.write_table(table.drop_columns(["policy_kl"]), older / "results.parquet")
    main([str(older), "--output", str(tmp_path / "out")])
    assert (tmp_path / "out" / "summary.csv").read_text().count("\n") == 5
    for file in older.rglob("result.json"):
        result = json.loads(file.read_text())
        del result["iterations"][0]["policy_kl"], result["iterations"][0]["initial_ddp_cost"]
        file.write_text(json.dumps(result))
    kl = write_table(older)["policy_kl"].to_pylist()
    assert kl[::2] == [None] * 8
    assert all(value > 0 for value in kl[1::2])


def test_pictures_are_replaced_only_where_that_is_asked_for(folder, tmp_path):
    arguments = [str(folder), "--output", str(tmp_path)]
    (tmp_path / "figure1.svg").write_text("mine")
    with pytest.raises(
        SystemExit, match=r"figure1\.svg' exists already; name another file or folder"
    ):
        main(arguments)
    assert (tmp_path / "figure1.svg").read_text() == "mine"
    main([*arguments, "--overwrite", "--average", "median"])
    assert (tmp_path / "figure1.svg").read_text() != "mine"


def test_bad_input_is_a_sentence(tmp_path):
    with pytest.raises(SystemExit, match=r"plot: '.*' has no results\.parquet; name the"):
        main([str(tmp_path)])
    (tmp_path / "results.parquet").write_text("nothing of the kind")
    with pytest.raises(SystemExit, match="is not a Parquet table"):
        main([str(tmp_path)])


def test_summary_takes_means_of_logarithms_and_says_when_a_policy_succeeds():
    """Three seeds, of which no quarter is left out, and three iterations; the DDP's cost is 10."""
    columns = {
        "initial_ddp_cost": np.full((3, 3), 10.0),
        "deterministic_cost": np.array([[90, 14, 11], [90, 90, 13.0], [90, 90, 12]]),
        "deterministic_survival": np.array([[1, 1, 1], [1, 1, 1], [0, 0, 0.0]]),
        "stochastic_cost_mean": np.array([[99, 99, 20], [99, 99, math.inf], [99, 99, 25]]),
        "stochastic_survival": np.array([[0, 0, 0.5], [0, 0, 1.0], [0, 0, 0.9]]),
        "simulator_steps": np.array([[1, 2, 3]] * 3) * 1_000_000,
        "seconds": np.array([[1.0, 2.0, 7.0]] * 3),
    }
    (row,) = summary({Panel("walker", 5): {"vgps": columns}}, "mean")
    assert row == pytest.approx(
        {
            "panel": "walker-5",
            "method": "vgps",
            "seeds": 3,
            "deterministic": (1.1 * 1.3 * 1.2) ** (1 / 3),
            "deterministic_low": 1.1,
            "deterministic_high": 1.3,
            "stochastic": (2.0 * CEILING * 2.5) ** (1 / 3),
            "stochastic_low": 2.0,
            "stochastic_high": CEILING,
            "succeed": 2,
            "success_at": 3.0,
            "survival": 0.9,
            "million_steps": 3.0,
            "seconds": 7.0,
        }
    )
