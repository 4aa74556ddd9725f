# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The choice of settings goes on where it was stopped, and writes what it has found."""

import csv
import importlib
import math
import sys
from dataclasses import replace

import pytest

pytest.importorskip("optuna", reason="pip install -r requirements/comparison.txt")


@pytest.fixture
def tuner(tmp_path, monkeypatch):
    """The script on the rotor, with two iterations, writing into a folder of its own."""
    module = importlib.import_module("benchmarks.figure1.tune")
    configured = module.configured

    def short(*arguments):
        task, settings = configured(*arguments)
        return task, replace(settings, iterations=2, evaluation_rollouts=2)

    tuned = tmp_path / "tuned.yaml"
    tuned.write_text("# What tuning chose.\n{}\n")
    for name, value in {
        "configured": short,
        "TASKS": ("rotor",),
        "UNITS": 2,
        "SPACES": {method: module.SPACES[method] for method in ("vgps", "gps")},
        "PAGE": tmp_path / "trials.csv",
        "TUNED": tuned,
    }.items():
        monkeypatch.setattr(module, name, value)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["tune", *arguments])
        module.main()
        return list(csv.DictReader(module.PAGE.open()))

    return module, run


def test_it_goes_on_and_writes_the_best(tuner):
    module, run = tuner
    run("--trials", "1", "--methods", "vgps")
    assert module.TUNED.read_text().endswith("{}\n")  # gps has had no trial yet
    first = run("--trials", "1", "--methods", "vgps", "gps")
    assert [(row["method"], row["trial"]) for row in first] == [("vgps", "0"), ("gps", "0")]
    assert float(first[0]["marginals.initial_std_factor"]) == 1.0  # what all methods share
    rows = run("--trials", "3", "--methods", "vgps", "gps")
    assert [row["method"] for row in rows] == ["vgps"] * 3 + ["gps"] * 3
    assert [row for row in rows if row["trial"] == "0"] == first
    assert run("--trials", "0") == rows
    best = module.yaml.safe_load(module.TUNED.read_text())["rotor"]
    for method in ("vgps", "gps"):
        own = [row for row in rows if row["method"] == method]
        row = min(own, key=lambda row: float(row["loss"]))
        for name, value in best[method].items():
            assert str(value) == row[name]
    assert module.TUNED.read_text().startswith("# What tuning chose.\n")


def test_a_training_that_fails_has_the_worst_loss(tuner, monkeypatch):
    module, _ = tuner

    def fails(*_):
        raise module.VgpsError("it flew away")

    monkeypatch.setattr(module, "search", fails)
    assert module.loss_of("vgps", "rotor", {}, 0) == math.log(module.WORST)
