# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Tunes PPO on the quadruped and trains it beside vgps: question 1 of docs/evidence/protocol.md.

Each trial is a line of docs/evidence/rivals_tuning.jsonl, each training one of rivals.jsonl, as
soon as it has ended; the same command goes on where it was stopped. The rows of vgps on the same
seeds are those of `benchmarks.parts`. It needs requirements/reinforcement.txt and comparison.txt:

    python -m benchmarks.rivals tune
    python -m benchmarks.rivals run --seeds 9101 9102 9103

`python -m benchmarks.evidence` then writes the tables.
"""

import argparse
import json
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution

from benchmarks.controller_peer import FIRST
from benchmarks.evidence import RIVALS_ROWS, TUNING_ROWS
from benchmarks.legs import vgps
from benchmarks.parts import SEEDS, judge, made
from benchmarks.sweep import Row, read_rows, sweep

TUNING_SEED = 9001
MINUTES, TRIAL_MINUTES = 12.0, 8.0  # of processor time
DRAWN = 5  # trials that are drawn at random, before a Gaussian process chooses
TIE = 0.1  # weight of the shares that stay up, beside those that obey
AROUND = np.sqrt(10.0)  # ranges are a factor of ten around the first trial's value


def space() -> dict[str, BaseDistribution]:
    """Returns the range of each setting."""
    found: dict[str, BaseDistribution] = {}
    for name, value in FIRST.items():
        kind = IntDistribution if isinstance(value, int) else FloatDistribution
        found[name] = kind(type(value)(value / AROUND), type(value)(value * AROUND), log=True)
    return found


def train(run: Path, seed: int, minutes: float, settings: dict[str, float]) -> list[Row]:
    """Trains PPO unless that has ended, and returns how its policies did in their choice."""
    given = ["--seed", str(seed), "--minutes", f"{minutes:g}", "--settings", json.dumps(settings)]
    command = [sys.executable, "-m", "benchmarks.controller_peer", *given, "--output", str(run)]
    if not (run / "policy.json").exists():
        shutil.rmtree(run, ignore_errors=True)  # of one that was stopped
        subprocess.run(command, check=True)
    return read_rows(run / "rows.jsonl")


def value_of(run: Path) -> Row:
    """Judges a trial; returns its part of a line: what counts, and what this is of."""
    file = run / "judged.json"
    words = f"--seed {TUNING_SEED} --seconds 10 --rollouts 8 --overwrite --json".split()
    vgps("evaluate", str(run), *words, str(file))
    found = json.loads(file.read_text())
    both = [found[name] for name in ("all_commands", "changing")]
    obeys, up = ([each[key][-1] for each in both] for key in ("obeys", "survival"))
    return {"value": sum(obeys) + TIE * sum(up), "obeys": obeys, "up": up}


def try_settings(trial: int, folder: Path) -> Row:
    """Trains with the settings that the trials before speak for, and returns its line."""
    sampler = optuna.samplers.GPSampler(seed=trial, n_startup_trials=DRAWN)
    study = optuna.create_study(sampler=sampler, direction="maximize")
    for row in read_rows(TUNING_ROWS):
        past = optuna.trial.create_trial(
            params=row["settings"], distributions=space(), value=row["value"]
        )
        study.add_trial(past)
    if not trial:
        study.enqueue_trial(FIRST)
    settings = study.ask(space()).params
    run = folder / f"trial-{trial}"
    *_, last = train(run, TUNING_SEED, TRIAL_MINUTES, settings)
    row = {"trial": trial, "seed": TUNING_SEED, "settings": settings} | value_of(run) | made()
    return row | {name: last[name] for name in ("processor_seconds", "simulator_steps")}


def best_settings() -> dict[str, float]:
    """Returns the settings of the best trial."""
    return dict(max(read_rows(TUNING_ROWS), key=lambda row: row["value"])["settings"])


def measured(method: str, seed: int, folder: Path) -> Row:
    """Trains PPO with the best settings and judges it; returns its line."""
    run = folder / f"{method}-{seed}"
    row: dict[str, Any] = {"method": method, "seed": seed, "settings": best_settings(), **made()}
    try:
        *tried, last = train(run, seed, MINUTES, best_settings())
    except subprocess.CalledProcessError as error:
        if error.returncode < 0:
            raise  # it was stopped
        return row | {"error": error.returncode}
    row |= {"core_seconds": last["processor_seconds"], "simulator_steps": last["simulator_steps"]}
    chosen = {"kept": last["try"], "success_of_tries": [each["success"] for each in tried]}
    return row | chosen | judge(run, run / "judged.json")


def main() -> None:
    """Does what the command line names."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("what", choices=("tune", "run"))
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--runs", type=Path, default=Path("recordings/rivals"))
    given = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    given.runs.mkdir(parents=True, exist_ok=True)
    if given.what == "tune":
        runs = [(trial,) for trial in range(given.trials)]
        rows = sweep(TUNING_ROWS, ("trial",), runs, partial(try_settings, folder=given.runs))
    else:
        pairs = [("PPO", seed) for seed in given.seeds]
        rows = sweep(RIVALS_ROWS, ("method", "seed"), pairs, partial(measured, folder=given.runs))
    for row in rows:
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
