# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trains policies for many robots, and writes the tables of docs/robots.md.

Each run adds a line to docs/robots/runs.jsonl when it ends; runs that have a line are not run
again, and one that was stopped goes on where it was. After `source env.bash`:

    python scripts/robot_table.py                        # all robots, seeds 0 to 2
    python scripts/robot_table.py --robots arm go1       # some of them
    python scripts/robot_table.py --robots $(cd benchmarks; ls without_demonstration/*.yaml)
    python scripts/robot_table.py --robots               # no runs: writes the page from the lines

Robots of others need `pip install -r requirements/robots.txt`.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from vgps_ros.core.ddp.solve import Iteration
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.experiments.training import train
from vgps_ros.search.checkpoints import Checkpoints
from vgps_ros.search.preparation import prepare
from vgps_ros.search.settings import SearchSettings, search_settings
from vgps_ros.search.situations import initial_states
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.storage.files import read_archive
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.tasks import Task, make_task
from vgps_ros.views.filmstrip import filmstrip
from vgps_ros.views.plots import save
from vgps_ros.views.run_record import read_results

ROOT = Path(__file__).resolve().parents[1]
PAGE, FOLDER = ROOT / "docs" / "robots.md", ROOT / "docs" / "robots"
RUNS = FOLDER / "runs.jsonl"
BEGIN, END = "<!-- table: robots -->\n", "<!-- end of table -->"
ALONE = "without_demonstration"  # folder of robots that start from a pose, and begins their names
OWN = ("swimmer", "walker", "cart_pole", "arm", "half_cheetah", "hopper", "quadruped")


def robots() -> dict[str, str]:
    """Returns what each robot's task is called by: built-in, of others, without demonstration."""
    others = sorted((ROOT / "tests" / "robots").glob("*.yaml"))
    alone = sorted((ROOT / "benchmarks" / ALONE).glob("*.yaml"))
    return (
        {name: name for name in OWN}
        | {path.stem: str(path) for path in others}
        | {f"{ALONE}/{path.stem}": str(path) for path in alone}
    )


def first_cost(task: Task, settings: SearchSettings, seed: int) -> tuple[float, float]:
    """Returns the mean cost of the motions from which the first solves start, and the time [s].

    The time is the processor's, of all threads, for all of these motions.
    """
    steps, costs, began = task.planned_horizon, [], time.process_time()
    for i, start in enumerate(initial_states(task, settings, seed)):
        if task.guess:
            controls = task.guess(generator(seed, Stream.INITIAL_CONTROLS, i))
            motion = task.dynamics.rollout(start, lambda t, _: controls[t], steps)  # noqa: B023
        else:
            rng = generator(seed, Stream.INITIAL_CONTROLS, i)
            motion = task.demonstration or task.demonstrate(start, steps, rng)  # type: ignore[misc]
        costs.append(task.trajectory_cost(motion.first(task.horizon)))
    return float(np.mean(costs)), time.process_time() - began


def run(name: str, reference: str, seed: int, folder: Path) -> dict[str, Any]:
    """Trains a policy, draws its motion, and returns the line of the run."""
    task = make_task(reference)
    settings = search_settings(task)
    prepare(task)
    output, times, log = RunFolder(folder / f"{name}_{seed}"), [time.perf_counter()], []

    def on_initial_ddp(iteration: Iteration) -> None:
        times.append(time.perf_counter())
        log.append(iteration)

    content = train(
        "vgps",
        task,
        settings,
        seed,
        output,
        on_initial_ddp=on_initial_ddp,
        checkpoints=Checkpoints(output.checkpoints, print),
    )
    last, ddp = content["iterations"][-1], content["initial_ddp_cost"]
    motions = read_archive(output.trajectories)
    initial, executed = motions["initial_states"], motions["executed_states"]
    time_moved = task.horizon * task.dynamics.time_step
    first, first_seconds = first_cost(task, settings, seed)
    seconds = sum(i["q_step_seconds"] + i["m_step_seconds"] for i in content["iterations"])
    return {
        "robot": name,
        "seed": seed,
        **task.dims,
        "hidden_units": content["hidden_units"],
        "iterations": len(content["iterations"]),
        "first_cost": first,
        "first_seconds": round(first_seconds, 1),
        "ddp_cost": ddp,
        "ddp_iterations": len(log),
        "ddp_seconds": float(np.median(np.diff(times))) if log else None,
        "deterministic": ratio(last["deterministic_cost"], ddp),
        "stochastic": ratio(last["stochastic_cost_mean"], ddp),
        "stochastic_median": ratio(last["stochastic_cost_median"], ddp),
        "deterministic_survival": last["deterministic_survival"],
        "stochastic_survival": last["stochastic_survival"],
        "seconds": round(seconds, 1),
        "ddp_survived": bool(task.survived(initial[None])[0]),
        "speeds": [
            float(task.distance(motion[0], motion[-1])) / time_moved
            for motion in (initial, executed)
        ],
    }


def ratio(cost: float | None, ddp: float) -> float | None:
    """Returns a cost divided by DDP's; None for a rollout that diverged."""
    return None if cost is None else cost / ddp


def draw(name: str, folder: Path) -> None:
    """Writes a small picture of the first policy's motion beside the page, unless it is there."""
    path, output = FOLDER / f"{name}.png", RunFolder(folder / f"{name}_0")
    if path.exists() or not output.trajectories.exists():
        return
    figure = filmstrip(read_results(output))
    if figure is None:
        return
    path.parent.mkdir(exist_ok=True)
    save(figure, path)
    with Image.open(path) as picture:
        small = picture.convert("RGB").resize((1000, round(1000 * picture.height / picture.width)))
    small.quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)


def table(lines: list[dict[str, Any]]) -> str:
    """Returns the table of all runs, and a picture of each robot."""
    text = (
        "| robot | n_x | n_u | DDP's cost, first → last | s/iteration | hidden units | "
        "deterministic ÷ DDP | with noise ÷ DDP, mean | median | survival, with noise | "
        "m/s, DDP → policy | training [s] |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|---|\n"
    )
    drawn = []
    for name, runs in grouped(lines):
        one = runs[0]
        cells = [
            name,
            one["n_dx"],
            one["n_u"],
            ", ".join(f"{r['first_cost']:.4g} → {r['ddp_cost']:.4g}" for r in runs),
            listed([r["ddp_seconds"] for r in runs], "{:.3f}"),
            ", ".join(str(units) for units in one["hidden_units"]),
            listed([r["deterministic"] for r in runs], "{:.2f}"),
            listed([r["stochastic"] for r in runs], "{:.2f}"),
            listed([r["stochastic_median"] for r in runs], "{:.2f}"),
            listed([percent(r) for r in runs], "{}"),
            listed([speeds(r) for r in runs], "{}"),
            listed([r["seconds"] for r in runs], "{:.0f}"),
        ]
        text += f"| {' | '.join(map(str, cells))} |\n"
        if (FOLDER / f"{name}.png").exists():
            drawn.append(f"\n{name}:\n\n![{name}](robots/{name}.png)\n")
    return text + "".join(drawn)


def percent(one: dict[str, Any]) -> str:
    """Returns the share of the rollouts that stayed up, without noise and with it."""
    return f"{one['deterministic_survival']:.0%}, {one['stochastic_survival']:.0%}"


def speeds(one: dict[str, Any]) -> str | None:
    """Returns the mean speed of DDP's motion and of the policy's; None for older runs."""
    return " → ".join(f"{speed:.2f}" for speed in one["speeds"]) if "speeds" in one else None


def listed(values: list[Any], form: str) -> str:
    """Returns the values of all seeds, one after another; a dash for one that is not known."""
    return " / ".join("–" if value is None else form.format(value) for value in values)


def grouped(lines: list[dict[str, Any]]) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yields the runs of each robot, in the order of the seeds."""
    for name in robots():
        runs = sorted((r for r in lines if r["robot"] == name), key=lambda r: r["seed"])
        if runs:
            yield name, runs


def known_lines() -> list[dict[str, Any]]:
    """Returns the lines of all runs so far."""
    return [json.loads(line) for line in RUNS.read_text().splitlines()] if RUNS.exists() else []


def write_page() -> None:
    """Writes the table into its page."""
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(before + BEGIN + table(known_lines()) + END + rest.partition(END)[2])


def main() -> None:
    """Runs what is missing, draws what is missing, and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="*", default=list(robots()), choices=list(robots()))
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--output", type=Path, default=ROOT / "recordings" / "robots")
    arguments = parser.parse_args()
    silence_mujoco()
    FOLDER.mkdir(parents=True, exist_ok=True)
    for seed in range(arguments.seeds):
        for name in arguments.robots:
            if any((r["robot"], r["seed"]) == (name, seed) for r in known_lines()):
                continue
            line = run(name, robots()[name], seed, arguments.output)
            with RUNS.open("a") as file:
                file.write(json.dumps(line) + "\n")
            print(json.dumps(line), flush=True)
    for name in robots():
        draw(name, arguments.output)
    write_page()


if __name__ == "__main__":
    main()
