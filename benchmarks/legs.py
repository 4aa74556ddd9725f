# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trains robots with legs that others brought, and judges how each obeys its commands.

Each seed is a line of docs/evidence/robots/legs.jsonl, which replaces an older one of the same
robot and seed. The task file is that of `vgps new`; what it is given stands behind `--`:

    python -m benchmarks.legs "Unitree Go2" recordings/go2 --seeds 0 1 -- --model go2/scene.xml

A folder that holds a task.yaml is not written anew, and a seed that has ended is not trained again.
`python -m benchmarks.evidence` then writes the table.
"""

import argparse
import json
import subprocess
import sys
import time
from datetime import date
from itertools import takewhile
from pathlib import Path
from typing import Any

from benchmarks.robots import last_change
from benchmarks.sweep import read_rows

RUNS = Path(__file__).resolve().parents[1] / "docs" / "evidence" / "robots" / "legs.jsonl"
PUSHES = (0, 10, 20, 25, 30, 40)  # [N·s]
LATE = 0.02  # [s]
JUDGED = ["--seconds", "20", "--rollouts", "8", "--pushes", *map(str, PUSHES)]
JUDGED += ["--latencies", "0", str(LATE)]


def vgps(*words: str) -> None:
    """Runs a command to its end."""
    subprocess.run([sys.executable, "-m", "vgps_ros.programs", *words], check=True)


def train(task: Path, seed: int) -> dict[str, Any]:
    """Trains one seed and returns how it obeys, with the minutes that this took."""
    run, judged = task / f"run-{seed}", task / f"judged-{seed}.json"
    taken = task / f"minutes-{seed}"
    if not taken.exists():  # it is written once the training has ended
        began = time.monotonic()
        vgps("train", "--task", str(task), "--seed", str(seed), "--output", str(run))
        taken.write_text(str((time.monotonic() - began) / 60))
    if not judged.exists():
        vgps("evaluate", str(run), *JUDGED, "--json", str(judged))
    result = json.loads(judged.read_text())
    held, changing = result["all_commands"], result["changing"]
    survival = result["robustness"]["pushes"]["survival"]
    borne = takewhile(lambda push: survival[PUSHES.index(push)] == 1.0, PUSHES)
    return {
        "up": held["survival"][-1],
        "obeys": held["obeys"][-1],
        "errors": [round(error, 4) for error in held["rms"].values()],
        "changing_up": changing["survival"][-1],
        "changing_obeys": changing["obeys"][-1],
        "borne": max(borne, default=0),
        "late": result["robustness"]["latencies"]["survival"][-1],
        "minutes": round(float(taken.read_text()), 1),
    }


def keep(row: dict[str, Any]) -> None:
    """Adds a training to the rows, in place of an older one."""
    own = (row["robot"], row["seed"])
    kept = [each for each in read_rows(RUNS) if (each["robot"], each["seed"]) != own]
    RUNS.write_text("".join(json.dumps(each) + "\n" for each in (*kept, row)))


def main() -> None:
    """Trains what the command line names."""
    words = sys.argv[1:]
    end = words.index("--") if "--" in words else len(words)
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("robot", help="its name in the table")
    parser.add_argument("task", type=Path, help="folder of its task file")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--note", default="", help="what a reader has to know of the robot")
    arguments = parser.parse_args(words[:end])
    if not (arguments.task / "task.yaml").exists():
        vgps("new", str(arguments.task), *words[end + 1 :])
    made = {"commit": last_change(), "date": str(date.today())}
    for seed in arguments.seeds:
        named = {"robot": arguments.robot, "note": arguments.note, "seed": seed}
        keep(named | train(arguments.task, seed) | made)


if __name__ == "__main__":
    main()
