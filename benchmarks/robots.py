# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trains one policy after another on fresh seeds, and judges each against converged DDP.

Each training is a line of docs/evidence/robots/runs.jsonl, which replaces an older one of the same
robot and seed; a line of the commit at hand is not measured again. After `source env.bash`:

    python -m benchmarks.robots                          # all robots, about an hour
    python -m benchmarks.robots swimmer without_demonstration/arm --seeds 8101

`python -m benchmarks.evidence` then writes the tables. Robots of others need
`pip install -r requirements/robots.txt`.
"""

import argparse
import json
import os
import platform
import subprocess
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from vgps_ros.core.ddp.solve import Solution, Status, solve
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_cost import ScaledCost
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.evaluation import perturbed_starts
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.tasks import Task, make_task

ROOT = Path(__file__).resolve().parents[1]
RUNS = ROOT / "docs" / "evidence" / "robots" / "runs.jsonl"
FRESH = (8101, 8102, 8103)  # no setting was chosen on them
OWN = ("swimmer", "walker", "cart_pole", "arm", "half_cheetah", "hopper")
ALONE = "without_demonstration"  # robots that begin with a pose; begins their names
ROLLOUTS = 20  # of the last policy with its noise
STARTS, PERTURBATION = 5, 0.01  # perturbed starts, and their standard deviation [rad]
MOST = 500  # iterations of DDP until it has converged; those of a perturbed start are as many


def robots() -> dict[str, str]:
    """Returns the task of each robot that learns a motion: built-in, of others, from a pose."""
    others = sorted((ROOT / "tests" / "other_robots").glob("*.yaml"))
    others = [path for path in others if "\ncommands:" not in path.read_text()]
    alone = sorted((ROOT / "benchmarks" / ALONE).glob("*.yaml"))
    return (
        {name: name for name in OWN}
        | {path.stem: str(path) for path in others}
        | {f"{ALONE}/{path.stem}": str(path) for path in alone}
    )


def measured(name: str, seed: int) -> dict[str, Any]:
    """Trains a robot's policy, and returns the line of the run."""
    task = make_task(robots()[name])
    settings = replace(search_settings(task), evaluation_rollouts=ROLLOUTS)
    began = time.process_time()
    *_, last = search("vgps", task, settings, seed, partial(optimize_all, task))
    seconds, ddp = time.process_time() - began, last.initial_ddp_cost
    first = last.initial_solutions[0]
    here = first.situation.of(task)
    converged = converged_motion(here, first.distribution.mean)
    starts = perturbed_starts(here, PERTURBATION, STARTS, generator(seed, Stream.EVALUATION, 0))
    costs, states, survived = costs_of(here, last.policy, np.vstack([here.initial_state, starts]))
    solved = [converged_motion(here, followed(here, converged, x)) for x in starts]
    optima = [here.trajectory_cost(s.trajectory.first(here.horizon)) for s in (converged, *solved)]
    return {
        "robot": name,
        "seed": seed,
        "commit": last_change(),
        "machine": f"{os.cpu_count()} cores of {platform.machine()}",
        "hidden_units": list(settings.hidden_units),
        "iterations": last.k,
        "ddp_cost": ddp,
        "deterministic": last.deterministic_cost / ddp,
        "stochastic_median": last.stochastic_cost_median / ddp,
        "stochastic_survival": last.stochastic_survival,
        "converged_cost": optima[0],
        "converged": [s.status is Status.CONVERGED for s in (converged, *solved)],
        "deterministic_to_converged": costs[0] / optima[0],
        "perturbed_to_converged": (costs[1:] / np.array(optima[1:])).tolist(),
        "perturbed_survival": float(survived[1:].mean()),
        "speed": float(here.distance(states[0, 0], states[0, -1]))
        / (here.horizon * here.dynamics.time_step),
        "seconds": round(seconds, 1),
    }


def converged_motion(task: Task, begin: Trajectory) -> Solution:
    """Returns what DDP for the cost alone makes of a motion, without an early end."""
    return solve(task.dynamics, ScaledCost(task.cost, 1.0), begin, task.optimizer.ddp, MOST)


def followed(task: Task, motion: Solution, start: Array) -> Trajectory:
    """Returns the motion from another start under a solution's own feedback."""
    (found,) = task.dynamics.follow_each(start, [motion.trajectory], motion.policy.gains)
    return found


def costs_of(
    task: Task, policy: GaussianPolicy, starts: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Returns cost, states and survival of a policy's rollouts without noise."""
    noise = np.zeros((len(starts), task.horizon, task.dynamics.control_dim))
    states, controls = task.dynamics.execute(policy, task.observation, starts, noise)
    return task.rollout_costs(states, controls), states, task.survived(states)


def last_change() -> str:
    """Returns the last commit that changed the package or a robot's file."""
    places = ("vgps_ros", "tests/other_robots", f"benchmarks/{ALONE}")
    command = ["git", "log", "-1", "--format=%h", "--abbrev=7", "--", *places]
    return subprocess.check_output(command, cwd=ROOT, text=True).strip()


def lines() -> list[dict[str, Any]]:
    """Returns the lines of all runs."""
    return [json.loads(line) for line in RUNS.read_text().splitlines()]


def enter(line: Mapping[str, Any]) -> None:
    """Enters the line of a run, in place of an older one of the same robot and seed."""
    kept = [old for old in lines() if [old[k] for k in _KEYS] != [line[k] for k in _KEYS]]
    order = list(robots())
    kept = sorted([*kept, dict(line)], key=lambda r: (order.index(r["robot"]), r["seed"]))
    RUNS.write_text("".join(json.dumps(each) + "\n" for each in kept))


_KEYS = ("robot", "seed")


def main() -> None:
    """Measures what the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("robots", nargs="*", choices=[[], *robots()], help="default: all")
    parser.add_argument("--seeds", type=int, nargs="+", default=FRESH)
    arguments = parser.parse_args()
    silence_mujoco()
    torch.set_num_threads(1)
    for seed in arguments.seeds:
        for name in arguments.robots or robots():
            known = [(r["robot"], r["seed"], r["commit"]) for r in lines()]
            if (name, seed, last_change()) not in known:
                line = measured(name, seed)
                enter(line)
                print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
