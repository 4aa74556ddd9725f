# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
r"""What each part of vgps brings to the quadruped: question 2 of docs/evidence/protocol.md.

Each training is a line of docs/evidence/parts.jsonl, written once its policy is judged. All
variants of a seed come before the next seed, so that they have the same seeds whenever it ends. The
same command goes on where it was stopped. The second command tries the program:

    python -m benchmarks.parts --hours 10
    python -m benchmarks.parts --seeds 9901 --runs recordings/trial --rows recordings/trial.jsonl \
        -- --iterations 3 --situations 6 --renew-begin 2 --renew-end 0

`python -m benchmarks.evidence` then writes the tables.
"""

import argparse
import ctypes
import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.legs import vgps
from benchmarks.robots import ROOT, last_change
from benchmarks.sweep import sweep
from vgps_ros.tasks.registry import task_file_of

ROWS = ROOT / "docs" / "evidence" / "parts.jsonl"
SEEDS = range(9101, 9111)
WHOLE, MEMORY = "as it is", "with memory"
VARIANTS = {
    WHOLE: "",
    "without visited states": "--visited-limit 0",
    "without replay": "--renew-replay 0",
    "without renewal": "--renew-begin 1000",  # the policy is still chosen and calibrated
    MEMORY: "",  # in its task file
    "with drawn robots": "--disturb-joints 1.0 --disturb-strength 0.2",
}
JUDGED = "--seed 9301 --seconds 20 --rollouts 40 --pushes 25 30 40 --dampings 0.5 2"
JUDGED += " --armatures 0.5 2 --contacts 1 --latencies 0.02"


def task_of(variant: str, folder: Path) -> str:
    """Returns the task: the built-in one, or a file that adds memory to it."""
    if variant != MEMORY:
        return "quadruped"
    own, file = task_file_of("quadruped"), folder / "task.yaml"
    assert own
    text = own.read_text().replace(": quadruped.xml", f": {own.with_name('quadruped.xml')}")
    file.write_text(text.replace("commands, clock]", "commands, clock, last_action]\nhistory: 2"))
    return str(file)


def take_over_orphans() -> None:
    """Makes processes children of this one whose parents have ended, as those of solvers."""
    set_subreaper = 36  # prctl(2)
    ctypes.CDLL(None).prctl(set_subreaper, 1)


def processor_seconds() -> float:
    """Waits for all children, and returns the processor time of all so far [s]."""
    with suppress(ChildProcessError):
        while True:
            os.waitpid(-1, 0)
    return sum(os.times()[2:4])


def train(run: Path, command: Sequence[str]) -> tuple[float, float]:
    """Trains a policy, or goes on with it; returns its processor and wall time [s]."""
    taken = run.with_name("seconds.json")
    core, wall = json.loads(taken.read_text()) if taken.exists() else (0.0, 0.0)
    core, wall = core - processor_seconds(), wall - time.monotonic()
    try:
        if not (run / "learning_curve.png").exists():  # the last file that a training writes
            vgps(*command, "--output", str(run))
    finally:
        core, wall = core + processor_seconds(), wall + time.monotonic()
        taken.write_text(json.dumps([core, wall]))
    return core, wall


def made() -> dict[str, str]:
    """Returns of what a line is: the last change of vgps, the machine and the day."""
    machine = f"{os.cpu_count()} cores of {platform.machine()}"
    return {"commit": last_change(), "machine": machine, "date": str(date.today())}


def judge(run: Path, file: Path) -> dict[str, Any]:
    """Judges a policy as the protocol says; returns its part of a line."""
    vgps("evaluate", str(run), *JUDGED.split(), "--json", str(file), "--overwrite")
    found = json.loads(file.read_text())
    kept = {"values", "survival", "obeys", "rms"}
    groups = {name: found[name] for name in ("all_commands", "changing")} | found["robustness"]
    return {n: {k: v for k, v in each.items() if k in kept} for n, each in groups.items()}


def measured(variant: str, seed: int, folder: Path, words: Sequence[str]) -> dict[str, Any]:
    """Trains a policy and judges it; returns its line."""
    folder = folder / f"{variant.replace(' ', '_')}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    run, own = folder / "run", VARIANTS[variant].split()
    own = ["vgps", "train", "--task", task_of(variant, folder), "--seed", str(seed), *words, *own]
    line: dict[str, Any] = {"variant": variant, "seed": seed, "command": " ".join(own)} | made()
    try:
        core, wall = train(run, own[1:])
    except subprocess.CalledProcessError as error:
        if error.returncode < 0:
            raise  # it was stopped
        return line | {"error": error.returncode}
    steps = json.loads((run / "result.json").read_text())["iterations"][-1]["simulator_steps"]
    line |= {"core_seconds": round(core), "wall_seconds": round(wall), "simulator_steps": steps}
    return line | judge(run, folder / "judged.json")


def main() -> None:
    """Measures what is missing, until the time is up."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--hours", type=float, default=24.0, help="after which none is begun")
    parser.add_argument("--runs", type=Path, default=Path("recordings/parts"))
    parser.add_argument("--rows", type=Path, default=ROWS)
    parser.add_argument("words", nargs="*", help="after --: of each `vgps train`")
    given = parser.parse_args()
    for end_of in (signal.SIGINT, signal.SIGTERM):  # which end the training, too
        signal.signal(end_of, lambda *_: sys.exit("Stopped; the same command goes on."))
    take_over_orphans()
    until = time.monotonic() + 3600 * given.hours
    runs = [(variant, seed) for seed in given.seeds for variant in VARIANTS]
    measure = partial(measured, folder=given.runs, words=given.words)
    for row in sweep(given.rows, ("variant", "seed"), runs, measure):
        print(json.dumps(row), flush=True)
        if time.monotonic() > until:
            break


if __name__ == "__main__":
    main()
