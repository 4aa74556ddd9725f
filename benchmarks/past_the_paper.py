# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Cost against simulator steps: vgps, steps of bounded divergence, GPS, and PPO and SAC beside.

Each training is a line of docs/evidence/past_the_paper.jsonl, which is written as it ends; a line
that is there is not measured again. After `source env.bash`:

    python -m benchmarks.past_the_paper swimmer cart_pole --seeds 8201 8202
    python -m benchmarks.past_the_paper --plot

`python -m benchmarks.evidence` then writes the table.
"""

import argparse
import json
import math
import os
import platform
import time
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figure1.curves import tuned
from benchmarks.reinforcement import Goal
from benchmarks.robots import last_change
from benchmarks.sweep import read_rows, sweep, table
from vgps_ros.core.settings import settings_of, with_values
from vgps_ros.search.cluster import Cluster
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.tasks import make_task

EVIDENCE = Path(__file__).resolve().parents[1] / "docs" / "evidence"
ROWS = EVIDENCE / "past_the_paper.jsonl"
SEEDS = (8201, 8202, 8203, 8204, 8205)  # no setting was chosen on them
METHODS: dict[str, tuple[str, dict[str, Any] | Callable[[], dict[str, Any]]]] = {
    "vgps": ("vgps", {}),
    "gps": ("gps", {}),
    "gps, tuned": ("gps", tuned),  # as Figure 1's is
    "vgps, 15 DDP iterations": ("vgps", {"initial_ddp_iterations": 15}),
    "average cost, model": ("mdgps", {}),
    "likelihood, model": ("mdgps", {"mirror.objective": "likelihood"}),
    "average cost, fitted": ("mdgps", {"mirror.dynamics": "fitted"}),
    "likelihood, fitted": (
        "mdgps",
        {"mirror.dynamics": "fitted", "mirror.objective": "likelihood"},
    ),
}
EXPLORATION = {"swimmer": 10.0, "cart_pole": 1.0, "walker": 1.0}  # [N·m], [N], [N·m]
ITERATIONS, FIRST_STEPS = 20, 40
# Of Stable-Baselines3, with the settings of its zoo, and the most simulator steps of each task.
PEERS = ("PPO", "SAC")
PEER_STEPS = {"swimmer": 1_400_000, "walker": 800_000}
PEER_SECONDS = 600.0  # after which a peer ends in any case


def measured(name: str, label: str, seed: int) -> dict[str, Any]:
    """Trains a policy; returns its line, whose lists have an entry for each iteration."""
    task, (method, own) = make_task(name), METHODS[label]
    own = own().get(name, {}).get(method, {}) if callable(own) else own
    known = {setting.name for setting in settings_of(task.optimizer)}
    of_optimizer = {key: value for key, value in own.items() if key in known}
    task = replace(task, optimizer=with_values(task.optimizer, of_optimizer))
    own = {key: value for key, value in own.items() if key not in known}
    shared = {
        "iterations": ITERATIONS,
        "mirror.exploration": (EXPLORATION[name],),
        "mirror.first_steps": FIRST_STEPS,
    }
    settings, began = with_values(search_settings(task), {**shared, **own}), time.process_time()
    found = list(search(method, task, settings, seed, partial(optimize_all, task)))
    return {
        **_begun(name, label, seed, began),
        "first_cost": found[0].initial_ddp_cost,
        "steps": [i.simulator_steps for i in found],
        "q_cost": _finite(i.ddp_cost for i in found),
        "deterministic": _finite(i.deterministic_cost for i in found),
        "stochastic_median": _finite(i.stochastic_cost_median for i in found),
        "stochastic_survival": [i.stochastic_survival for i in found],
    }


def peer_measured(name: str, label: str, seed: int) -> dict[str, Any]:
    """Trains a peer; returns its line, whose lists have an entry for each look at it."""
    from benchmarks import stable_baselines as peers

    task, algorithm = make_task(name), next(a for a in peers.ZOO if a.__name__ == label)
    goal = Goal("no goal", task.horizon, task.trajectory_cost, -np.inf)
    steps, began = PEER_STEPS[name] // task.dynamics.substeps, time.process_time()
    found = peers.learn(algorithm, task, goal, None, PEER_SECONDS, seed=seed, steps=steps)
    return {
        **_begun(name, label, seed, began),
        "steps": [count for count, _ in found.curve],
        "deterministic": _finite(cost for _, cost in found.curve),
    }


def _begun(name: str, label: str, seed: int, began: float) -> dict[str, Any]:
    """Returns what each line begins with: what was trained, by what, and in which time."""
    return {
        "task": name,
        "method": label,
        "seed": seed,
        "commit": last_change(),
        "machine": f"{os.cpu_count()} cores of {platform.machine()}",
        "seconds": round(time.process_time() - began, 1),
    }


def _finite(costs: Iterable[float]) -> list[float | None]:
    """Returns costs as JSON values: null where a rollout diverged."""
    return [cost if math.isfinite(cost) else None for cost in costs]


def plot() -> None:
    """Draws the cost without noise over simulator steps, a panel for each task."""
    import matplotlib.pyplot as plt

    rows = read_rows(ROWS)
    names = list(dict.fromkeys(row["task"] for row in rows))
    figure, axes = plt.subplots(1, len(names), figsize=(5 * len(names), 3.6), squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        for i, label in enumerate((*METHODS, *PEERS)):
            own = [r for r in rows if (r["task"], r["method"]) == (name, label)]
            for n, row in enumerate(own):
                shown = {"color": f"C{i}", "label": label if n == 0 else None}
                costs = np.array(row["deterministic"], dtype=float)  # null becomes NaN
                axis.plot(row["steps"], costs, marker=".", **shown)
        least = min(c for r in rows if r["task"] == name for c in r["deterministic"] if c)
        axis.set(xscale="log", title=name, xlabel="simulator steps")
        axis.set_ylim(0.8 * least, 6.0 * least)  # what is above has failed
    axes[0, 0].set_ylabel("cost without noise")
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(EVIDENCE / "past_the_paper.png", dpi=110)


def main() -> None:
    """Measures what is missing, or draws the lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=["swimmer", "cart_pole"])
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=(*METHODS, *PEERS))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--cluster", metavar="ADDRESS", help="Dask scheduler to measure by")
    parser.add_argument("--plot", action="store_true")
    given = parser.parse_args()
    if given.plot:
        plot()
        return
    if set(PEERS) & set(given.methods) and (lacking := set(given.tasks) - set(PEER_STEPS)):
        parser.error(f"{' and '.join(PEERS)} learn {' and '.join(PEER_STEPS)}, not {lacking.pop()}")
    runs = product(given.tasks, given.methods, given.seeds)
    ordered = sorted(runs, key=lambda run: given.seeds.index(run[2]))
    with Cluster(given.cluster) if given.cluster else nullcontext() as executor:
        for row in sweep(ROWS, ("task", "method", "seed"), ordered, _measured, executor):
            print(json.dumps(row), flush=True)
    print(table(read_rows(ROWS), ("task", "method"), _last_cost))


def _last_cost(row: dict[str, Any]) -> float:
    """Returns the cost without noise at the end; infinite where that rollout diverged."""
    last = row["deterministic"][-1]
    return math.inf if last is None else last


def _measured(name: str, label: str, seed: int) -> dict[str, Any]:
    silence_mujoco()  # in the process of a worker, too
    return (peer_measured if label in PEERS else measured)(name, label, seed)


if __name__ == "__main__":
    main()
