# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Chooses the settings of each method of the comparison, with as many trials for each.

A trial trains a method with one choice of settings on the ten-unit panel of a task, on seeds that
no figure uses. Its loss is the mean over these seeds, over the policy with and without its noise
(the median rollout), and over the last five iterations, of log(cost ÷ initial DDP solution's), each
at most log 1,000. The first trial of each has the settings that the methods share; a Gaussian
process chooses the others. Trials go round the methods, so that all have had as many whenever the
script is stopped. `cost_weighted_1000` has the settings of `cost_weighted`: it is the same method,
whose trials would take as long as those of all others together.

It needs an environment with `pip install -r requirements/comparison.txt`. After `source env.bash`:

    python -m benchmarks.figure1.tune

Each trial is a row of docs/evidence/figure1_tuning.csv as soon as it has ended, and the script
goes on from that table. Where all methods have had as many trials, it writes the best settings of
each into benchmarks/figure1/tuned.yaml, from where `python -m benchmarks.figure1 run` takes them.
"""

import argparse
import csv
import itertools
import json
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import torch
import yaml
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.trial import TrialState

from benchmarks.figure1.curves import TUNED, configured
from vgps_ros.core.errors import VgpsError
from vgps_ros.core.settings import settings_of
from vgps_ros.search.methods import search
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.tasks import make_task

PAGE = Path(__file__).resolve().parents[2] / "docs" / "evidence" / "figure1_tuning.csv"
TASKS, UNITS, SEEDS = ("swimmer", "walker"), 10, (900, 901)
LAST, WORST, LEAST = 5, 1000.0, 1e-4
OF_ALL: Mapping[str, BaseDistribution] = {
    "ddp.distribution_regularization": FloatDistribution(LEAST, 0.3, log=True),
    "marginals.initial_std_factor": FloatDistribution(1.0, 5.0),
}
WIDE = {"marginals.velocity_noise": FloatDistribution(0.0, 0.03)}
ADAPTS = {"ddp_iterations": IntDistribution(1, 10, log=True)}
FITS = {"fit.iterations": IntDistribution(1, 100, log=True)}
GUIDED = {
    "gps.guiding_noise": FloatDistribution(0.02, 1.0, log=True),
    "gps.redraw": CategoricalDistribution((False, True)),
}
# Four settings of each method: those of the marginals that every method begins with, and the two
# that matter most to it (docs/evidence/comparison.md).
SPACES: Mapping[str, Mapping[str, BaseDistribution]] = {
    "vgps": {**OF_ALL, **WIDE, **ADAPTS},
    "gps": {**OF_ALL, **GUIDED},
    "adaptive_gps": {**OF_ALL, **GUIDED},
    "dagger": {**OF_ALL, **WIDE, **FITS},
    "weighted_dagger": {**OF_ALL, **WIDE, **FITS},
    "adapted_weighted_dagger": {**OF_ALL, **WIDE, **ADAPTS},
    "cost_weighted": {**OF_ALL, **WIDE, **FITS},
}
SHARED = {"cost_weighted_1000": "cost_weighted"}
Studies = Mapping[tuple[str, str], optuna.Study]


def loss_of(method: str, task_name: str, own: Mapping[str, Any], seed: int) -> float:
    """Trains a method once, and returns its loss on this seed."""
    task, settings = configured(make_task(task_name), method, own)
    task.dynamics.simulations.threads = 1
    settings = replace(settings, hidden_units=(UNITS,))
    try:
        *_, last = search(
            method, task, settings, seed, lambda requests: [optimize(task, r) for r in requests]
        )
    except VgpsError as error:
        print(f"  seed {seed} fails: {error}", flush=True)
        return math.log(WORST)
    rows = last.history[-LAST:]
    costs = [(row.deterministic_cost, row.stochastic_cost_median) for row in rows]
    ratios = np.nan_to_num(np.array(costs) / rows[-1].initial_ddp_cost, nan=WORST, posinf=WORST)
    return float(np.log(np.minimum(ratios, WORST)).mean())


def try_one(study: optuna.Study, method: str, task: str) -> None:
    """Does the next trial of a method on a task, and enters it in the study."""
    count = len(study.trials)
    # A seed of its own for each trial: one that goes on must not draw the first trials again.
    study.sampler = optuna.samplers.GPSampler(seed=count, n_startup_trials=5)
    if not count:
        study.enqueue_trial(shared_values(method, task))
    trial, began = study.ask(dict(SPACES[method])), time.process_time()
    losses = [loss_of(method, task, trial.params, seed) for seed in SEEDS]
    trial.set_user_attr("losses", losses)
    trial.set_user_attr("seconds", time.process_time() - began)
    study.tell(trial, float(np.mean(losses)))


def shared_values(method: str, task_name: str) -> dict[str, Any]:
    """Returns the settings that all methods share, those of the method's space."""
    task, settings = configured(make_task(task_name), method, {})
    known = {s.name: s.default for r in (task.optimizer, settings) for s in settings_of(r)}
    values = {name: known[name] for name in SPACES[method]}
    name = "ddp.distribution_regularization"
    return values | {name: max(values[name], LEAST)}  # the space has no 0


def finished(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    """Returns the trials of a study that have been finished."""
    return study.get_trials(states=[TrialState.COMPLETE])


def begun() -> Studies:
    """Returns a study of each method on each task, with the trials of the table."""
    studies = {names: optuna.create_study() for names in itertools.product(TASKS, SPACES)}
    rows = list(csv.DictReader(PAGE.open())) if PAGE.exists() else []
    for row in rows:
        space = SPACES[row["method"]]
        values = {name: json.loads(row[name].lower()) for name in space}  # True is true in JSON
        trial = optuna.trial.create_trial(
            params=values,
            distributions=dict(space),
            value=float(row["loss"]),
            user_attrs={
                "losses": [float(row[f"loss_{seed}"]) for seed in SEEDS],
                "seconds": float(row["seconds"]),
            },
        )
        studies[row["task"], row["method"]].add_trial(trial)
    return studies


def write(studies: Studies) -> None:
    """Writes all trials, and the best settings of each method where all have had as many."""
    names = list(dict.fromkeys(name for space in SPACES.values() for name in space))
    head = ("task", "method", "trial", "loss", *(f"loss_{seed}" for seed in SEEDS), "seconds")
    best: dict[str, dict[str, dict[str, Any]]] = {}
    with PAGE.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow((*head, *names))
        for (task, method), study in studies.items():
            for i, trial in enumerate(finished(study)):
                figures = (trial.value, *trial.user_attrs["losses"], trial.user_attrs["seconds"])
                shown = (f"{figure:.4g}" for figure in figures)
                values = (trial.params.get(name, "") for name in names)
                rows.writerow((task, method, i, *shown, *values))
            if finished(study):
                best.setdefault(task, {})[method] = study.best_params
    if len({len(finished(study)) for study in studies.values()}) > 1:
        return
    for own in best.values():
        own |= {other: dict(own[method]) for other, method in SHARED.items() if method in own}
    comment = next(line for line in TUNED.read_text().splitlines() if line.startswith("#"))
    TUNED.write_text(f"{comment}\n{yaml.safe_dump(best, sort_keys=False)}")


def main() -> None:
    """Runs the trials that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--trials", type=int, default=6, help="of each method on each task")
    parser.add_argument("--methods", nargs="+", choices=SPACES, default=list(SPACES))
    arguments = parser.parse_args()
    silence_mujoco()
    torch.set_num_threads(1)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    studies = begun()
    for count in range(arguments.trials):
        for (task, method), study in studies.items():
            if method in arguments.methods and len(finished(study)) <= count:
                try_one(study, method, task)
                write(studies)
                done = finished(study)[-1]
                print(f"{task} {method} {count + 1}: {done.value:.3f} {done.params}", flush=True)


if __name__ == "__main__":
    main()
