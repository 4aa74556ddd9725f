# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trains policies on seeds that no setting was chosen on, and writes docs/policies.md.

Task, units and seed are all that a training is given; the rest are the defaults. Each training adds
a line to docs/policies.jsonl once it is measured; those that have a line are not run again, and one
that was stopped goes on where it was. After `source env.bash`:

    python scripts/policy_table.py                  # all trainings, about two hours
    python scripts/policy_table.py --tasks walker --seeds 701 702
    python scripts/policy_table.py --seeds          # no trainings: writes the page from the lines
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PAGE, LINES = ROOT / "docs" / "policies.md", ROOT / "docs" / "policies.jsonl"
BEGIN, END = "<!-- table: policies -->\n", "<!-- end of table -->"
# Of each task the networks: the number of units, or of those of each layer.
UNITS: dict[str, tuple[int | list[int], ...]] = {
    "swimmer": (5, 10),
    "walker": (10, 5),
    "hopper": ([64, 64],),
}
FRESH = range(701, 711)
NOISY = ("--rollouts", "40", "--stochastic")
# Of each trial of a robot that can fall: its name, its length [s], and its further arguments.
TRIALS = {
    "walker": (
        ("perturbed_20s", 20, ("--rollouts", "20")),
        ("noise_4s", 4, NOISY),
        ("noise_20s", 20, NOISY),
    ),
    "hopper": (("perturbed_10s", 10, ("--rollouts", "40")), ("noise_4s", 4, NOISY)),
}
# What each column shows: its title, its form, and which of its values is the worst.
COLUMNS: dict[str, tuple[str, str, Callable[..., float]]] = {
    "deterministic_cost": ("without noise ÷ DDP", "{:.3f}", max),
    "stochastic_cost_mean": ("with noise ÷ DDP, mean", "{:.3f}", max),
    "stochastic_cost_median": ("median", "{:.3f}", max),
    "perturbed_10s": ("perturbed, without noise, 10 s", "{:.0%}", min),
    "perturbed_20s": ("perturbed, without noise, 20 s", "{:.0%}", min),
    "noise_4s": ("with noise, 4 s", "{:.0%}", min),
    "noise_20s": ("with noise, 20 s", "{:.0%}", min),
    "seconds": ("processor time [s]", "{:.0f}", max),
}


def vgps(*arguments: object) -> float:
    """Runs a command of `vgps`, and returns the processor time that it took [s]."""
    before = os.times()
    words = [sys.executable, "-m", "vgps_ros.programs", *map(str, arguments)]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return after.children_user + after.children_system - before[2] - before[3]


def run(task: str, units: int | list[int], seed: int, folder: Path) -> dict[str, Any]:
    """Trains and tries a policy, and returns its line."""
    layers = units if isinstance(units, list) else [units]
    output = folder / "-".join(map(str, (task, *layers, seed)))
    flags = ("--hidden-units", *layers, "--seed", seed)
    timed = output / "seconds.json"
    if not timed.exists():
        timed.write_text(json.dumps(vgps("train", "--task", task, *flags, "--output", output)))
    seconds = json.loads(timed.read_text())
    result = json.loads((output / "result.json").read_text())
    last, ddp = result["iterations"][-1], result["initial_ddp_cost"]
    line = {"task": task, "units": units, "seed": seed, "seconds": seconds, "ddp_cost": ddp}
    # A rollout that diverged has no cost.
    line |= {name: last[name] and last[name] / ddp for name in COLUMNS if name in last}
    line |= {"noise_std": last["noise_std"]}
    for name, length, more in TRIALS.get(task, ()):
        file = output / f"{name}.json"
        vgps("evaluate", output, "--seconds", length, *more, "--json", file, "--overwrite")
        line[name] = json.loads(file.read_text())["survival"]
    return line


def places(tasks: Iterable[str]) -> list[tuple[str, int | list[int]]]:
    """Returns each task with each of its numbers of units."""
    return [(task, units) for task in tasks for units in UNITS[task]]


def table(lines: Sequence[dict[str, Any]]) -> str:
    """Returns a table for each task and size, with the median and the worst of all seeds."""
    text = ""
    for task, units in places(UNITS):
        rows = [line for line in lines if (line["task"], line["units"]) == (task, units)]
        if not rows:
            continue
        rows.sort(key=lambda line: line["seed"])
        columns = {name: column for name, column in COLUMNS.items() if name in rows[0]}
        titles = " | ".join(["seed", *(title for title, _, _ in columns.values())])
        size = " and ".join(map(str, units)) if isinstance(units, list) else units
        text += f"\n{task}, {size} units:\n\n| {titles} |\n|{'---|' * (len(columns) + 1)}\n"
        shown = {str(row["seed"]): [row[name] for name in columns] for row in rows}
        values = {name: [worth(row[name]) for row in rows] for name in columns}
        shown["**median**"] = [np.median(values[name]) for name in columns]
        shown["**worst**"] = [worst(values[name]) for name, (_, _, worst) in columns.items()]
        for head, cells in shown.items():
            forms = (form for _, form, _ in columns.values())
            said = (form.format(worth(cell)) for form, cell in zip(forms, cells, strict=True))
            text += f"| {head} | {' | '.join(said)} |\n"
    return text + "\n"


def worth(value: float | None) -> float:
    """Returns a value; infinity for the cost of a rollout that diverged."""
    return np.inf if value is None else value


def known_lines() -> list[dict[str, Any]]:
    """Returns the lines of all trainings so far."""
    return [json.loads(line) for line in LINES.read_text().splitlines()] if LINES.exists() else []


def main() -> None:
    """Runs what is missing, and writes the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", nargs="+", choices=UNITS, default=list(UNITS))
    parser.add_argument("--seeds", nargs="*", type=int, default=list(FRESH))
    parser.add_argument("--output", type=Path, default=ROOT / "recordings" / "policies")
    arguments = parser.parse_args()
    for seed in arguments.seeds:
        for task, units in places(arguments.tasks):
            known = [(line["task"], line["units"], line["seed"]) for line in known_lines()]
            if (task, units, seed) in known:
                continue
            line = json.dumps(run(task, units, seed, arguments.output.resolve()))
            with LINES.open("a") as file:
                file.write(line + "\n")
            print(line, flush=True)
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(before + BEGIN + table(known_lines()) + END + rest.partition(END)[2])


if __name__ == "__main__":
    main()
