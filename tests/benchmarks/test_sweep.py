# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Sweeps go on where they were stopped, in this process and elsewhere."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from benchmarks.sweep import read_rows, sweep, table

RUNS = [(task, seed) for task in ("rotor", "arm") for seed in range(4)]


def measure(task, seed):
    return {"task": task, "seed": seed, "cost": float(seed) if task == "arm" else 1.0}


def swept(file, done, executor=None):
    def measured(*run):
        done.append(run)
        return measure(*run)

    return sweep(file, ("task", "seed"), RUNS, measured, executor)


@pytest.mark.parametrize("threads", [0, 3])
def test_a_sweep_that_is_stopped_goes_on_with_what_has_no_line(tmp_path, threads):
    file, done = tmp_path / "rows.jsonl", []
    begun = swept(file, done)
    first = [next(begun) for _ in range(3)]
    begun.close()
    assert read_rows(file) == first == [measure(*run) for run in RUNS[:3]]
    assert done == RUNS[:3]
    if threads:
        with ThreadPoolExecutor(threads) as executor:
            later = list(swept(file, done, executor))
    else:
        later = list(swept(file, done))
    assert sorted(done) == sorted(RUNS)
    assert read_rows(file) == first + later
    assert list(swept(file, done)) == []


def test_the_table_leaves_out_the_best_and_the_worst_quarter(tmp_path):
    file = tmp_path / "rows.jsonl"
    list(swept(file, []))
    *_, arm, rotor = table(read_rows(file), ("task",), lambda row: row["cost"]).splitlines()
    assert arm.startswith("| arm | 4 | 1.5 (")
    assert rotor == "| rotor | 4 | 1 (1 to 1) |"
