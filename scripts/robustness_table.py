# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trains walkers on several numbers of pushes, tries them, and writes docs/robustness.md's table.

Each policy is tried from 40 perturbed starts for 10 s, with each size of push, slope and payload:
the pushes of these trials are in no training. What has been trained or tried is not done again, so
a script that was stopped goes on. It writes docs/robustness.json, its picture, and the table of the
page, with all policies of the output folder. After `source env.bash`:

    python scripts/robustness_table.py                          # all policies
    python scripts/robustness_table.py --policies "1 start" "1 push"
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vgps_ros.search.robustness import ENOUGH
from vgps_ros.views.plots import save
from vgps_ros.views.robustness import survival_curves

ROOT = Path(__file__).resolve().parents[1]
PAGE, RESULTS = ROOT / "docs" / "robustness.md", ROOT / "docs" / "robustness.json"
BEGIN, END = "<!-- table: robustness -->\n", "<!-- end of table -->"
OF_ALL = ("--task", "walker", "--seed", "401", "--hidden-units", "64", "--alphas", "0.3", "5")
PUSHED = ("--disturb-push", "40")
LATER = (*PUSHED, "--disturb-start-before", "1.2", "--situations")
POLICIES = {
    "1 start": (),
    "1 push": PUSHED,
    "2 pushes": (*LATER, "2"),
    "4 pushes": (*LATER, "4"),
    "8 pushes": (*LATER, "8"),
}
PUSHES = (0, 10, 20, 30, 40, 50, 60)  # [N·s]
TRIALS = (
    *("--rollouts", "40", "--seconds", "10", "--seed", "500"),
    *("--pushes", *map(str, PUSHES), "--payloads", "0", "5", "10", "15", "20"),
    *("--slopes", "-0.1", "-0.05", "0", "0.05", "0.075", "0.1"),
)


def measured(label: str, folder: Path) -> dict[str, Any]:
    """Returns what `vgps evaluate` says of a policy, which is trained and tried if it has not."""
    found = trials_of(label, folder)
    output = found.parent
    if not found.exists():
        print(f"{label} ...", flush=True)
        if not (output / "distribution.npz").exists():  # the last file that a training writes
            vgps("train", *OF_ALL, *POLICIES[label], "--output", str(output))
        vgps("evaluate", str(output), *TRIALS, "--json", str(found))
    result: dict[str, Any] = json.loads(found.read_text())
    return result


def trials_of(label: str, folder: Path) -> Path:
    """Returns the file of a policy's trials."""
    return folder / label.replace(" ", "_") / "robustness.json"


def vgps(*words: str) -> None:
    """Runs a command of `vgps`."""
    command = [sys.executable, "-m", "vgps_ros.programs", *words]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def table(found: Mapping[str, Mapping[str, Any]]) -> str:
    """Returns the table of all policies."""
    head = [f"{push} N·s" for push in PUSHES]
    head = ["policy", *head, "push, slope and payload borne by 90 %"]
    text = f"\n| {' | '.join(head)} |\n|{'---|' * len(head)}\n"
    for label, result in found.items():
        own = result["robustness"]
        shares = own["pushes"]["survival"]
        cells = [f"{share:.0%}".replace("%", " %") for share in shares]
        (_, push), slope, (_, payload) = (
            own[kind]["borne"] or (0.0, 0.0) for kind in ("pushes", "slopes", "payloads")
        )
        borne = f"{push:g} N·s, {slope[0]:g} to {slope[1]:g} rad, {payload:g} kg"
        cells.append(borne if shares[0] >= ENOUGH else "falls without any")
        text += f"| {label} | {' | '.join(cells)} |\n"
    return text + "\n"


def main() -> None:
    """Measures what is missing, and writes the page's table and picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--policies", nargs="+", choices=POLICIES, default=list(POLICIES))
    parser.add_argument("--output", type=Path, default=ROOT / "recordings" / "robustness")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    found = {
        label: measured(label, arguments.output)
        for label in POLICIES
        if label in arguments.policies or trials_of(label, arguments.output).exists()
    }
    RESULTS.write_text(json.dumps(found, indent=1) + "\n")
    rollouts = next(iter(found.values()))["rollouts"]
    shares = {label: result["robustness"] for label, result in found.items()}
    save(survival_curves(shares, rollouts), RESULTS.with_suffix(".png"))
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(before + BEGIN + table(found) + END + rest.partition(END)[2])


if __name__ == "__main__":
    main()
