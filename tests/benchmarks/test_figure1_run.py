# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The comparison as users run it: in processes, killed and started again, on a cluster."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import dask
import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster

from benchmarks.figure1 import cells, curves, runner
from benchmarks.figure1.__main__ import main as figure1
from benchmarks.figure1.cells import Cell, Panel, Protocol, all_cells, run_cell
from benchmarks.figure1.curves import CURVES, RISING
from benchmarks.figure1.table import read_table
from vgps_ros.search.settings import search_settings
from vgps_ros.tasks import make_task

pytestmark = pytest.mark.slow

SMALL = ["--panels", "rotor-3", "--seeds", "2", "--iterations", "3", "--evaluation-rollouts", "4"]
CELLS = 2 * len(CURVES)


def main(arguments):
    figure1(["run", *arguments])


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """An experiment of all methods that nothing interrupts."""
    folder = tmp_path_factory.mktemp("undisturbed")
    main([*SMALL, "--output", str(folder), "--jobs", "2"])
    return folder


def start(folder: Path) -> subprocess.Popen:
    """Starts the program in a process group of its own."""
    command = [sys.executable, "-m", "benchmarks.figure1", "run", *SMALL]
    command += ["--output", str(folder), "--jobs", "2"]
    return subprocess.Popen(
        command, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def finished(folder: Path) -> dict[Path, int]:
    """Result files of finished cells, and when they were written."""
    results = folder.glob("runs/rotor-3/*/seed-[01]/result.json")
    return {path: path.stat().st_mtime_ns for path in results}


def without_seconds(folder: Path):
    table = read_table(folder)
    return table.drop_columns([name for name in table.column_names if name.endswith("seconds")])


def test_every_cell_has_a_row_for_each_iteration(undisturbed):
    table = read_table(undisturbed)
    assert table.num_rows == 3 * CELLS
    keys = {(row["method"], row["seed"], row["iteration"]) for row in table.to_pylist()}
    assert keys == {(m, s, k) for m in CURVES for s in (0, 1) for k in (1, 2, 3)}
    assert (undisturbed / "results.csv").read_text().count("\n") == 1 + 3 * CELLS
    assert not (undisturbed / "failures.json").exists()
    on_policy, none = (
        {r["simulator_steps"] for r in table.to_pylist() if r["method"] == m and r["seed"] == 0}
        for m in ("cost_weighted", "vgps")
    )
    assert max(on_policy) - min(on_policy) == 2 * 10 * 50  # ten rollouts of 50 steps an iteration
    assert len(none) == 3


def test_killed_and_started_again_it_goes_on_and_gives_the_same_table(undisturbed, tmp_path):
    folder = tmp_path / "killed"
    program = start(folder)
    while len(finished(folder)) < CELLS // 2:
        assert program.poll() is None
        time.sleep(0.05)
    os.killpg(program.pid, signal.SIGKILL)  # with its workers
    program.wait()
    for left in Path("/dev/shm").glob(f"*[-_]{program.pid}[-_]*"):  # nobody else can remove it
        shutil.rmtree(left) if left.is_dir() else left.unlink()
    before = finished(folder)
    assert CELLS // 2 <= len(before) < CELLS
    again = start(folder)
    output, _ = again.communicate(timeout=120)
    assert again.returncode == 0
    assert f"{CELLS} cells, {len(before)} of them finished before" in output
    assert re.search(
        rf"^{CELLS}/{CELLS} after 0:\d\d:\d\d: rotor-3 \w+ seed 1 finished$", output, re.M
    )
    after = finished(folder)
    assert {path: after[path] for path in before} == before  # none was run twice
    assert without_seconds(folder).equals(without_seconds(undisturbed))
    assert not list(folder.rglob("*.unfinished*"))


def test_seeds_may_begin_elsewhere(undisturbed):
    main([*SMALL[:2], *SMALL[4:], *("--methods", "dagger", "--seeds", "1", "--first-seed", "900"),
          *("--jobs", "1", "--output", str(undisturbed))])  # fmt: skip
    seeds = {row["seed"] for row in read_table(undisturbed).to_pylist()}
    assert seeds == {0, 1, 900}
    shutil.rmtree(undisturbed / "runs" / "rotor-3" / "dagger" / "seed-900")
    runner.write_table(undisturbed)


def test_a_second_one_is_refused_and_ctrl_c_ends_the_first(tmp_path):
    program = start(tmp_path / "interrupted")
    while not finished(tmp_path / "interrupted"):
        assert program.poll() is None
        time.sleep(0.05)
    with pytest.raises(SystemExit, match=r"An experiment is running in '.*interrupted' now"):
        main([*SMALL, "--output", str(tmp_path / "interrupted")])
    program.send_signal(signal.SIGINT)
    _, errors = program.communicate(timeout=60)
    assert program.returncode == 1
    assert "figure1 run: interrupted; the same command goes on" in errors


def test_a_cluster_of_two_workers_gives_the_same_table(undisturbed, tmp_path):
    with (
        dask.config.set(temporary_directory=str(tmp_path)),
        LocalCluster(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
        ) as cluster,
    ):
        address = cluster.scheduler_address
        main([*SMALL, "--output", str(tmp_path / "c"), "--backend", "dask", "--address", address])
    assert without_seconds(tmp_path / "c").equals(without_seconds(undisturbed))


def test_a_cell_that_fails_is_recorded_and_the_rest_goes_on(tmp_path, monkeypatch):
    def fails_for_one(cell, protocol, root):
        if cell.method == "gps":
            return "DivergenceError: it flew away."
        return run_cell(cell, protocol, root)

    monkeypatch.setattr(runner, "run_cell", fails_for_one)
    with pytest.raises(SystemExit, match="1 cells failed"):
        main(
            [
                *("--panels", "rotor-2", "--methods", "gps", "cost_weighted", "--seeds", "1"),
                *("--iterations", "1", "--jobs", "1", "--output", str(tmp_path / "out")),
            ]
        )
    failures = json.loads((tmp_path / "out" / "failures.json").read_text())
    assert failures == [{"cell": "rotor-2 gps seed 0", "error": "DivergenceError: it flew away."}]
    assert set(read_table(tmp_path / "out")["method"].to_pylist()) == {"cost_weighted"}


@pytest.fixture
def trained(monkeypatch):
    """What cells were trained with, method, task and settings of each; none is trained."""
    found = []
    monkeypatch.setattr(cells, "train", lambda *arguments: found.append(arguments[:3]))
    return found


@pytest.mark.parametrize("name", ["swimmer", "walker"])
def test_a_cell_has_the_papers_schedule_and_what_tuning_chose(tmp_path, monkeypatch, trained, name):
    own = {"ddp_iterations": 7, "marginals.initial_std_factor": 2.5}
    monkeypatch.setattr(curves, "tuned", lambda: {name: {"vgps": own}})
    for method in ("vgps", "dagger"):
        run_cell(Cell(Panel(name, 7), method, 0), Protocol.of(50, 1), tmp_path)
    (_, task, settings), (_, other, _) = trained
    assert [settings.alpha(k) for k in (0, 50, 99)] == pytest.approx([1.0, 0.1, 0.1])
    assert (settings.ddp_iterations, settings.hidden_units) == (7, (7,))
    factors = [each.optimizer.marginals.initial_std_factor for each in (task, other)]
    assert factors == [2.5, 1.0]
    assert task.optimizer.bound_tolerance == other.optimizer.bound_tolerance == 0.0


def test_the_rising_curve_has_the_tasks_own_settings(tmp_path, trained):
    run_cell(Cell(Panel("walker", 10), RISING, 0), Protocol.of(50, 20), tmp_path)
    ((method, task, settings),) = trained
    own = make_task("walker")
    assert method == "vgps"
    assert task.optimizer == own.optimizer
    assert settings == replace(search_settings(own), hidden_units=(10,))
    assert settings.alpha(50) > settings.alpha(0)


def test_what_tuning_chose_is_valid_for_every_curve():
    for name, own in curves.tuned().items():
        assert set(own) < set(CURVES)
        for curve in own:
            curves.configured(make_task(name), curve)


def test_an_error_within_a_cell_is_returned_and_leaves_no_results(tmp_path, monkeypatch):
    def explodes(*_, **__):
        raise ArithmeticError("no more numbers")

    monkeypatch.setattr(cells, "train", explodes)
    cell = Cell(Panel("rotor", 3), "vgps", 0)
    assert run_cell(cell, Protocol.of(1, 1), tmp_path) == "ArithmeticError: no more numbers"
    assert not cell.is_finished(tmp_path)


def test_a_cell_that_another_worker_has_finished_stays_as_it_is(tmp_path):
    """As after a kill of the program alone, whose workers finish their cells."""
    cell, protocol = Cell(Panel("rotor", 2), "dagger", 0), Protocol.of(1, 1)
    assert run_cell(cell, protocol, tmp_path) == ""
    result = cell.folder(tmp_path) / "result.json"
    before = result.stat().st_mtime_ns
    assert run_cell(cell, protocol, tmp_path) == ""
    assert result.stat().st_mtime_ns == before
    assert [f.name for f in cell.folder(tmp_path).parent.iterdir()] == ["seed-0"]


def test_what_is_no_cell_is_passed_over(tmp_path):
    (tmp_path / "runs" / "rotor-3" / "vgps" / "seed-1.unfinished-abc").mkdir(parents=True)
    (tmp_path / "runs" / "rotor-3" / "notes" / "seed-0").mkdir(parents=True)
    (tmp_path / "runs" / "rotor-3" / "vgps" / "seed-2").mkdir()
    assert cells.finished_cells(tmp_path) == [Cell(Panel("rotor", 3), "vgps", 2)]


def test_panels_and_methods_named_twice_are_run_once():
    panel = Panel.named("rotor-3")
    assert all_cells([panel, panel], ["vgps", "vgps"], [0]) == [Cell(panel, "vgps", 0)]


def test_one_seed_of_each_comes_before_the_next_seed_of_any():
    panels = [Panel.named("walker-5"), Panel.named("rotor-3")]
    order = [(c.seed, str(c.panel), c.method) for c in all_cells(panels, ["vgps", "gps"], range(2))]
    assert order[:4] == [
        (0, "walker-5", "vgps"), (0, "walker-5", "gps"), (0, "rotor-3", "vgps"),
        (0, "rotor-3", "gps"),
    ]  # fmt: skip
    assert {seed for seed, _, _ in order[4:]} == {1}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--methods", "ppo"], "method is 'ppo', but it must be one of adapted_weighted_dagger"),
        (["--panels", "crawler-5"], "panel is 'crawler-5', but it must be all (swimmer-5"),
        (["--panels", "swimer-5"], "Did you mean 'swimmer-5'?"),
        (["--panels", "walker"], "panel is 'walker'"),
        (["--panels", "walker-0"], "panel is 'walker-0'"),
        (["--backend", "proceses"], "Did you mean 'processes'?"),
        (["--backend", "dask", "--address", "nonsense"], "No Dask scheduler answers at 'nonsense'"),
        (["--jobs", "0"], "jobs is 0, but it must be a number of processes"),
        (["--jobs", "-5"], "jobs is -5, but it must be from -1 to 1024"),
        (["--jobs", "99999999999"], "jobs is 99999999999, but"),
        (["--address", "tcp://host:8786"], "'tcp://host:8786', but only the backend dask"),
        (["--seeds", "0"], "seeds is 0, but it must be"),
        (["--iterations", "-1"], "iterations is -1"),
    ],
)
def test_bad_input_names_the_value_and_what_is_right(tmp_path, arguments, sentence, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--panels", "rotor-3", *arguments, "--output", str(tmp_path / "out")])
    assert sentence in str(stop.value.code) + capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_folder_of_another_experiment_is_refused(undisturbed, tmp_path):
    before = pq.read_table(undisturbed / "results.parquet")
    with pytest.raises(SystemExit, match=r"with iterations 3, .* but this one has iterations 4"):
        main([*SMALL, "--iterations", "4", "--output", str(undisturbed)])
    assert pq.read_table(undisturbed / "results.parquet").equals(before)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(SystemExit, match="is not the folder of an experiment"):
        main([*SMALL, "--output", str(tmp_path)])
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
