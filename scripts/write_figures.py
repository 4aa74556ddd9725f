# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs the trainings whose figures the pages quote, and writes these figures into the pages.

Every figure in a block between `<!-- figures: NAME -->` and `<!-- end of figures -->` comes from
docs/figures.json, which this program writes from real runs. After `source env.bash`:

    python scripts/write_figures.py              # all parts; finished runs are not run again
    python scripts/write_figures.py --parts swimmer --seeds 3
    python scripts/write_figures.py --parts      # no runs: writes the blocks from figures.json
    python scripts/write_figures.py --check      # fails if a page differs from figures.json

The runs lie in recordings/figures, or in the folder that --output names. A training that was
stopped goes on where it was, and one that has ended is taken as it is, as three_robots/swimmer. All
parts together take about a quarter of an hour on two cores.
"""

import argparse
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from comparison_blocks import summed_up
from matplotlib.figure import Figure
from onnx_parity import parity
from page_blocks import ROOT, Figures, pages, with_figures
from PIL import Image

from vgps_ros.programs.evaluate import evaluate
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.storage.policy_file import open_policy
from vgps_ros.storage.run_folder import RunFolder, load_policy
from vgps_ros.tasks import Task, make_task
from vgps_ros.tasks.driving import driver_of
from vgps_ros.tasks.walker.simbicon import GAIT, walk
from vgps_ros.views.filmstrip import filmstrip, frames
from vgps_ros.views.plots import phase_portrait, save
from vgps_ros.views.run_record import RunRecord, read_results

FIGURES = ROOT / "docs" / "figures.json"
THREE_RATE, THREE_SIZE = 25.0, (160, 224)  # pictures a second; height and width of each [pixels]
FIVE_UNITS = ROOT / "config" / "walker" / "five_units.yaml"


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
        "four_initial_states": run("four-initial-states", 10, 0, "--situations", 4),
    }


def demonstration(output: Path, seeds: int) -> Figures:
    """Walks for 30 s under the walker's demonstration, and improves it by DDP."""
    task = make_task("walker")
    x = walk(task.dynamics, GAIT, round(30.0 / task.dynamics.time_step)).states
    steps = search_settings(task).initial_ddp_iterations
    request = OptimizationRequest(0, 0, 0, 1.0, steps, task.initial_state)
    solution = optimize(task, request)
    save_picture(filmstrip, motion(task, x[: task.horizon + 1]), "walker_demonstration.png")
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


def ten_units(output: Path, seeds: int) -> list[Figures]:
    """Trains walkers of ten units, and draws how the first one walks for 4 s and for 60 s."""
    rows, task = walker(output, seeds, 10, 50), make_task("walker")
    folder = output / "walker-10-units-seed-0"
    save_picture(filmstrip, read_results(RunFolder(folder)), "walker_filmstrip.png")
    policy, _ = load_policy(folder / "policy.json")
    law = lambda t, x: policy.mean(task.observation(x))  # noqa: E731
    long = task.dynamics.rollout(task.initial_state, law, 6000)
    save_picture(phase_portrait, motion(task, long.states), "walker_60s.png", colours=16)
    return rows


def motion(task: Task, states: np.ndarray) -> RunRecord:
    """Returns a run that has executed these states and that is not known further."""
    return RunRecord(task.mjcf, task.dynamics.time_step, executed_states=states)


def save_picture(
    draw: Callable[[RunRecord], Figure | None], run: RunRecord, name: str, colours: int = 256
) -> None:
    """Draws a run and writes the picture to docs/, in few colours so that the file is small."""
    picture = draw(run)
    assert picture is not None
    path = ROOT / "docs" / name
    save(picture, path)
    Image.open(path).convert("RGB").quantize(colours).save(path, optimize=True)


def walker_trials(path: Path) -> Figures:
    """Returns the shares of rollouts that do not fall, and how far the policy goes in 60 s."""
    task = make_task("walker")
    driver = driver_of(task, open_policy(path))

    def trial(seconds: float, rollouts: int, sd: float, *, stochastic: bool = False) -> Figures:
        return evaluate(
            task, driver, seconds=seconds, rollouts=rollouts, perturbation=sd, seed=5,
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
    if not (folder / "plots" / "filmstrip.png").exists():
        shutil.rmtree(folder, ignore_errors=True)
        flags = ["env", "TASK=swimmer", "HIDDEN=5", "SEED=0", "ITERATIONS=50", f"OUTPUT={folder}"]
        with log.open("w") as file:
            subprocess.run([*flags, "scripts/run_demo.bash"], check=True, stdout=file, cwd=ROOT)
        subprocess.run(["ros2", "run", "vgps_ros", "plot", str(folder)], check=True)
    for name in ("learning_curve.png", "trajectory.png", "motion.png", "filmstrip.png"):
        shutil.copy(folder / "plots" / name, ROOT / "docs" / name)
    said = log.read_text().replace(str(folder), "recordings/swimmer-...")
    return {"output": [line.rstrip() for line in said.splitlines()]}


def three_robots(output: Path, seeds: int) -> Figures:
    """Draws three robots with their policies as one moving picture at half speed."""
    strips = []
    for name in ("swimmer", "walker", "quadruped"):
        folder, task = output / "three_robots" / name, make_task(name)
        train(folder, "--task", name, "--seed", 0)
        strips.append(frames_of(task, folder, seconds=2.0))
    pictures = [
        Image.fromarray(np.hstack(side_by_side)) for side_by_side in zip(*strips, strict=True)
    ]
    save_gif(pictures, ROOT / "docs" / "robots.gif", round(2e3 / THREE_RATE))
    return {"bytes": (ROOT / "docs" / "robots.gif").stat().st_size}


def frames_of(task: Task, folder: Path, seconds: float) -> Iterator[np.ndarray]:
    """Yields pictures of a policy without noise that drives its robot from x_1."""
    policy, _ = load_policy(folder / "policy.json")
    law = lambda t, x: policy.mean(task.observation(x))  # noqa: E731
    steps = round(seconds / task.dynamics.time_step)
    states = task.dynamics.rollout(task.initial_state, law, steps).states
    shown = np.arange(0, seconds, 1.0 / THREE_RATE) / task.dynamics.time_step
    return frames(task.mjcf, states[shown.round().astype(int)], *THREE_SIZE)


def save_gif(pictures: list[Image.Image], target: Path, duration: float) -> None:
    """Writes pictures, each shown for a duration [ms], as a GIF of few colours."""
    palette = pictures[0].quantize(48)  # one palette for all: colours must not flicker
    first, *rest = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]
    first.save(target, save_all=True, append_images=rest, duration=duration, loop=0, optimize=True)


def exported(output: Path, seeds: int) -> Figures:
    """Trains a policy for each of a few robots and compares it with its ONNX files."""
    rows = {}
    for name in ("swimmer", "walker", "quadruped"):
        folder = output / f"exported-{name}"
        few = ("--iterations", 2, "--initial-ddp-iterations", 5, "--evaluation-rollouts", 2)
        train(folder, "--task", name, "--seed", 0, *few)
        rows[name] = parity(make_task(name), load_policy(folder / "policy.json")[0])
    return rows


PARTS: dict[str, Callable[[Path, int], Any]] = {
    "swimmer": swimmer,
    "demo": demo,
    "three_robots": three_robots,
    "demonstration": demonstration,
    "exported": exported,
    "comparison": lambda output, seeds: summed_up(ROOT / "docs" / "figure1.csv"),
    "walker": ten_units,
    "walker_five_units": lambda output, seeds: walker(
        output, seeds, 5, 130, "--params-file", FIVE_UNITS
    ),
}


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
