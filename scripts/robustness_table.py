# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trains walkers in several situations, and writes table and picture of docs/robustness.md.

Runs lie in recordings/robustness; one that was stopped goes on where it was. What each policy bears
is kept in docs/robustness.jsonl, a line a policy; one that has a line is not run again. After
`source env.bash`:

    python scripts/robustness_table.py --seed 401                   # all policies of a seed
    python scripts/robustness_table.py --policies "8 pushes"        # some of them
    python scripts/robustness_table.py --policies                   # writes the page from the lines
"""

import argparse
import json
import re
from pathlib import Path
from typing import Any

from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.views.plots import save
from vgps_ros.views.robustness import survival_curves

ROOT = Path(__file__).resolve().parents[1]
PAGE, LINES = ROOT / "docs" / "robustness.md", ROOT / "docs" / "robustness.jsonl"
RUNS = ROOT / "recordings" / "robustness"
BLOCK = re.compile(r"(<!-- table: robustness -->\n).*?(<!-- end of table -->)", re.S)
ROLLOUTS = 40
PUSH = ("--disturb-push", "40")
ON_THE_WAY = ("--disturb-start-before", "1.2")
# The options of each policy; the samples of a step share what one situation has, so that a fit
# takes as long.
POLICIES = {
    "1 start": (),
    "4 perturbed starts": ("--situations", "4", "--fit-samples-per-step", "15"),
    "4 starts on the way": (*ON_THE_WAY, "--situations", "4", "--fit-samples-per-step", "15"),
    "1 push, awaited": (*PUSH, "--disturb-push-before", "2"),
    "1 push": (*PUSH, *ON_THE_WAY),
    "8 pushes": (*PUSH, *ON_THE_WAY, "--situations", "8", "--fit-samples-per-step", "8"),
}
DRAWN = ("1 start", "4 starts on the way", "1 push", "8 pushes")
TRIALS = (
    *("--pushes", *map(str, range(0, 90, 10)), "--payloads", "0", "5", "10", "15", "20"),
    *("--slopes", "-0.15", "-0.1", "-0.05", "0", "0.025", "0.05", "0.075", "0.1"),
)


def measured(name: str, seed: int) -> dict[str, Any]:
    """Trains a policy unless that was done, tries it, and returns its line."""
    folder = RUNS / f"{name.replace(' ', '-').replace(',', '')}-{seed}"
    given = ["--task", "walker", "--hidden-units", "10", "--seed", str(seed), *POLICIES[name]]
    if not (folder / "learning_curve.png").exists():
        vgps(["train", *given, "--output", str(folder)])
    trials = folder / "trials.json"
    tried = ["--rollouts", str(ROLLOUTS), "--seed", "500", "--json", str(trials), "--overwrite"]
    vgps(["evaluate", str(folder), *tried, *TRIALS])
    noisy = folder / "noisy.json"
    tried[-2] = str(noisy)
    vgps(["evaluate", str(folder), *tried, "--stochastic", "--seconds", "20"])
    return {
        "policy": name,
        "seed": seed,
        "with_noise": json.loads(noisy.read_text())["survival"],
        **{key: json.loads(trials.read_text())[key] for key in ("survival", "robustness")},
    }


def table(lines: list[dict[str, Any]]) -> str:
    """Returns a row for each policy."""
    head = "policy | seed | push | slope | payload | without noise, 10 s | with noise, 20 s"
    rows = [f"| {head} |", "|---" * 7 + "|"]
    for line in lines:
        (_, push), (down, up), (_, payload) = (
            line["robustness"][kind]["borne"] for kind in ("pushes", "slopes", "payloads")
        )
        rows.append(
            f"| {line['policy']} | {line['seed']} | {push:g} N·s | {down:g} to {up:g} rad | "
            f"{payload:g} kg | {100 * line['survival']:.0f} % | {100 * line['with_noise']:.0f} % |"
        )
    return "\n".join(rows) + "\n"


def main() -> None:
    """Runs what is named and has no line yet, and writes the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--policies", nargs="*", choices=POLICIES, default=list(POLICIES))
    parser.add_argument("--seed", type=int, default=401)
    given = parser.parse_args()
    lines = [json.loads(line) for line in LINES.read_text().splitlines()] if LINES.exists() else []
    known = {(line["policy"], line["seed"]) for line in lines}
    for name in given.policies:
        if (name, given.seed) not in known:
            lines.append(measured(name, given.seed))
            with LINES.open("a") as file:
                file.write(json.dumps(lines[-1], ensure_ascii=False) + "\n")
    order = list(POLICIES)
    lines.sort(key=lambda line: (line["seed"], order.index(line["policy"])))
    PAGE.write_text(BLOCK.sub(lambda m: m[1] + table(lines) + m[2], PAGE.read_text()))
    first = [line for line in lines if line["seed"] == lines[0]["seed"]]
    drawn = {line["policy"]: line["robustness"] for line in first if line["policy"] in DRAWN}
    save(survival_curves(drawn, ROLLOUTS), ROOT / "docs" / "robustness.png")


if __name__ == "__main__":
    main()
