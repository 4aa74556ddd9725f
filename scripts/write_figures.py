"""Runs the trainings whose figures the pages quote, and writes these figures into the pages.

Every figure in a block between `<!-- figures: NAME -->` and `<!-- end of figures -->` comes from
docs/figures.json, which this program writes from real runs. After `source env.bash`:

    python scripts/write_figures.py              # all parts; finished runs are not run again
    python scripts/write_figures.py --parts swimmer --seeds 3
    python scripts/write_figures.py --parts      # no runs: writes the blocks from figures.json
    python scripts/write_figures.py --check      # fails if a page differs from figures.json

The runs lie in recordings/figures, or in the folder that --output names. A training that was
stopped goes on where it was. All parts together take about an hour on two cores.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageSequence

from vgps_ros.programs.evaluate import evaluate
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import OptimizationRequest, TrajectoryOptimizer
from vgps_ros.storage.policy_file import load_policy
from vgps_ros.tasks import make_task
from vgps_ros.tasks.simbicon import GAIT, walk

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures.json"
BLOCK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- end of figures -->)", re.S)
FIVE_UNITS = ROOT / "config" / "walker" / "five_units.yaml"
Figures = dict[str, Any]


def train(folder: Path, *arguments: object) -> Figures:
    """Trains into a folder, unless that was done before, and returns the costs at the end."""
    if not (folder / "learning_curve.png").exists():
        flags = [str(argument) for argument in arguments]
        command = ["ros2", "run", "vgps_ros", "train", *flags, "--output", str(folder)]
        subprocess.run(command, check=True)
    result = json.loads((folder / "result.json").read_text())
    last, ddp = result["iterations"][-1], result["initial_ddp_cost"]
    return {
        "seed": result["seed"],
        "initial_ddp_cost": ddp,
        "deterministic": last["deterministic_cost"] and last["deterministic_cost"] / ddp,
        "stochastic": last["stochastic_cost_mean"] and last["stochastic_cost_mean"] / ddp,
    }


def swimmer(output: Path, seeds: int) -> Figures:
    """Trains swimmers of 5 and of 10 hidden units, and one from four initial states."""

    def run(name: str, units: int, seed: int, *more: object) -> Figures:
        flags = ("--task", "swimmer", "--hidden-units", units, "--seed", seed, "--iterations", 50)
        return train(output / "swimmer" / name, *flags, *more)

    return {
        "5": [run(f"5-units-seed-{seed}", 5, seed) for seed in range(seeds)],
        "10": [run(f"10-units-seed-{seed}", 10, seed) for seed in range(seeds)],
        "four_initial_states": run("four-initial-states", 10, 0, "--num-initial-states", 4),
    }


def demonstration(output: Path, seeds: int) -> Figures:
    """Walks for 30 s under the walker's demonstration, and improves it by DDP."""
    task = make_task("walker")
    x = walk(task.dynamics, GAIT, round(30.0 / task.dynamics.time_step)).states
    steps = search_settings(task).initial_ddp_iterations
    request = OptimizationRequest(0, 0, 0, 1.0, steps, task.initial_state)
    solution = TrajectoryOptimizer(task).optimize(request)
    return {
        "speed": float(x[-1, 0] - x[0, 0]) / 30.0,
        "fell": bool(task.fallen(x).any()),
        "lowest_hips": float(x[:, 1].min()),
        "largest_pitch": float(np.abs(x[:, 2]).max()),
        "cost_per_step": task.trajectory_cost(task.demonstration.first(task.horizon))
        / task.horizon,
        "ddp_iterations": len(solution.iterations),
        "ddp_cost_per_step": solution.cost / task.horizon,
    }


def walker(output: Path, seeds: int, units: int, iterations: int, *more: object) -> list[Figures]:
    """Trains walkers and tries each from x_1, from perturbed starts and with noise."""
    rows = []
    for seed in range(seeds):
        folder = output / f"walker-{units}-units-seed-{seed}"
        row = train(
            folder, "--task", "walker", "--hidden-units", units, "--seed", seed,
            "--iterations", iterations, "--evaluation-rollouts", 4, *more,
        )  # fmt: skip
        del row["stochastic"]  # of four rollouts, too few to quote
        trials = folder / "trials.json"
        if not trials.exists():
            trials.write_text(json.dumps(walker_trials(folder / "policy.json")))
        rows.append(row | json.loads(trials.read_text()))
    return rows


def walker_trials(path: Path) -> Figures:
    """Returns the shares of rollouts that do not fall, and how far the policy goes in 60 s."""
    task, (policy, _) = make_task("walker"), load_policy(path)

    def trial(seconds: float, rollouts: int, sd: float, *, stochastic: bool = False) -> Figures:
        return evaluate(
            task, policy, seconds=seconds, rollouts=rollouts, perturbation=sd, seed=5,
            stochastic=stochastic,
        )  # fmt: skip

    return {
        "from_x1": trial(20.0, 1, 0.0)["survival"],
        "perturbed": trial(10.0, 20, 0.01)["survival"],
        "with_noise": trial(4.0, 40, 0.01, stochastic=True)["survival"],
        "distance_60s": trial(60.0, 1, 0.0)["distance"]["mean"],
    }


def demo(output: Path, seeds: int) -> Figures:
    """Runs `make demo`'s script for the swimmer; returns what it prints, copies its pictures."""
    folder, log = output / "demo", output / "demo.log"
    if not (folder / "plots" / "motion.gif").exists():
        shutil.rmtree(folder, ignore_errors=True)
        flags = ["env", "TASK=swimmer", "HIDDEN=5", "SEED=0", "ITERATIONS=50", f"OUTPUT={folder}"]
        with log.open("w") as file:
            subprocess.run([*flags, "scripts/run_demo.bash"], check=True, stdout=file, cwd=ROOT)
        subprocess.run(["ros2", "run", "vgps_ros", "plot", str(folder)], check=True)
    for name in ("learning_curve.png", "trajectory.png", "motion.png", "filmstrip.png"):
        shutil.copy(folder / "plots" / name, ROOT / "docs" / name)
    write_small_gif(folder / "plots" / "motion.gif", ROOT / "docs" / "swimmer.gif")
    said = log.read_text().replace(str(folder), "recordings/swimmer-...")
    return {"output": [line.rstrip() for line in said.splitlines()]}


def write_small_gif(source: Path, target: Path) -> None:
    """Writes every second frame of a moving picture, which a page loads in half of the time."""
    with Image.open(source) as picture:
        duration = 2 * picture.info["duration"]
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(picture)][::2]
    palette = frames[0].quantize(48)  # one palette for all: colours must not flicker
    first, *rest = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    first.save(target, save_all=True, append_images=rest, duration=duration, loop=0, optimize=True)


PARTS: dict[str, Callable[[Path, int], Any]] = {
    "swimmer": swimmer,
    "demo": demo,
    "demonstration": demonstration,
    "walker": lambda output, seeds: walker(output, seeds, 10, 50),
    "walker_five_units": lambda output, seeds: walker(
        output, seeds, 5, 130, "--params-file", FIVE_UNITS
    ),
}


def swimmer_block(figures: Figures) -> str:
    """Says how the swimmers end."""
    rows = [*figures["swimmer"]["5"], *figures["swimmer"]["10"]]
    four = figures["swimmer"]["four_initial_states"]
    return (
        f"Over seeds {_seeds(rows)}, with 5 and with 10 hidden units, the policy without noise "
        f"ends at {_range(rows, 'deterministic', '.2f')} of the initial DDP solution's cost, and "
        f"the policy with noise at {_range(rows, 'stochastic', '.2f')}. One policy of 10 units "
        "that learned from four initial states swims from all of them, at "
        f"{four['deterministic']:.3f} and {four['stochastic']:.2f}."
    )


def demo_block(figures: Figures) -> str:
    """Shows the beginning and the end of what the demo prints."""
    lines = figures["demo"]["output"]
    last = next(i for i, line in enumerate(lines) if line.lstrip().startswith("50/50"))
    table = [line for line in lines[last:] if line.startswith("│")]
    paths = [line for line in lines if line.startswith(("Bag:", "Recording:", "Learning curve:"))]
    shown = [*lines[:4], " ...", *lines[last : last + 2], *table, *paths]
    return "\n".join(["```", *shown, "```"])


def walker_block(figures: Figures) -> str:
    """Makes the table of the walker's page."""
    shown = figures["demonstration"]
    table = [
        "| measured | |",
        "| --- | --- |",
        f"| speed of the demonstration, over 30 s | {shown['speed']:.2f} m/s |",
        f"| its cost per step, and after {shown['ddp_iterations']} DDP iterations | "
        f"{shown['cost_per_step']:.3f}, {shown['ddp_cost_per_step']:.3f} |",
    ]
    for name, units, iterations in (("walker", 10, 50), ("walker_five_units", 5, 130)):
        rows = figures[name]
        walks = sum(row["from_x1"] == 1.0 for row in rows)
        table += [
            f"| {units} units, seeds {_seeds(rows)}, {iterations} iterations: cost without noise, "
            "as a multiple of the initial DDP solution's | "
            f"{_list(rows, 'deterministic', '.2f')} |",
            f"| {units} units without noise from x_1: walk for 20 s | {walks} of {len(rows)} |",
            f"| {units} units without noise from x_1: distance in 60 s | "
            f"{_list(rows, 'distance_60s', '.1f')} m |",
            f"| {units} units without noise, 20 perturbed starts (0.01 rad, 0.1 rad/s): walk for "
            f"10 s | {_list(rows, 'perturbed', '.0%')} |",
            f"| {units} units with noise, 40 rollouts: walk for 4 s | "
            f"{_list(rows, 'with_noise', '.0%')} |",
        ]
    return "\n".join(table)


def five_units_block(figures: Figures) -> str:
    """Makes the table of five units, a row a seed."""
    head = "seed | cost without noise / initial DDP's | 20 s from x_1 | 20 perturbed starts, 10 s"
    table = [f"| {head} | with noise, 40 rollouts, 4 s |", "| --- | --- | --- | --- | --- |"]
    for row in figures["walker_five_units"]:
        walks = "walks" if row["from_x1"] == 1.0 else "falls"
        table.append(
            f"| {row['seed']} | {row['deterministic']:.3f} | {walks} | {row['perturbed']:.0%} | "
            f"{row['with_noise']:.0%} |"
        )
    return "\n".join(table)


BLOCKS: dict[str, Callable[[Figures], str]] = {
    "swimmer": swimmer_block,
    "demo": demo_block,
    "walker": walker_block,
    "five_units": five_units_block,
}


def _values(rows: Iterable[Figures], key: str, form: str) -> list[str]:
    return ["diverged" if row[key] is None else f"{row[key]:{form}}" for row in rows]


def _list(rows: Iterable[Figures], key: str, form: str) -> str:
    return ", ".join(_values(rows, key, form)).replace("%", " %")


def _range(rows: Iterable[Figures], key: str, form: str) -> str:
    values = sorted(_values(rows, key, form))
    return f"{values[0]} to {values[-1]}"


def _seeds(rows: list[Figures]) -> str:
    return f"{rows[0]['seed']} to {rows[-1]['seed']}"


def pages() -> list[Path]:
    """Returns the pages that may hold blocks."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def with_figures(page: str, figures: Figures) -> str:
    """Returns a page's text with each block as the figures give it."""
    return BLOCK.sub(lambda m: f"{m[1]}{BLOCKS[m[2]](figures)}\n{m[3]}", page)


def main() -> None:
    """Runs the parts that are named and writes the pages, or checks them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--parts", nargs="*", choices=PARTS, default=list(PARTS), help="what to run"
    )
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds, from 0 on")
    parser.add_argument("--output", type=Path, default=ROOT / "recordings" / "figures")
    parser.add_argument("--check", action="store_true", help="compare the pages, write nothing")
    parsed = parser.parse_args()
    if not parsed.check:
        parsed.output.mkdir(parents=True, exist_ok=True)
        for part in parsed.parts:
            measured = PARTS[part](parsed.output.resolve(), parsed.seeds)
            # Read anew: another call may have written other parts meanwhile.
            figures = json.loads(FIGURES.read_text()) if FIGURES.exists() else {}
            content = json.dumps(figures | {part: measured}, indent=1, ensure_ascii=False)
            FIGURES.write_text(content + "\n")
    figures = json.loads(FIGURES.read_text())
    for page in pages():
        text = page.read_text()
        wanted = with_figures(text, figures)
        if parsed.check and wanted != text:
            sys.exit(
                f"'{page}' differs from what docs/figures.json gives: run "
                "`python scripts/write_figures.py --parts`, and commit what it writes."
            )
        page.write_text(wanted)


if __name__ == "__main__":
    main()
