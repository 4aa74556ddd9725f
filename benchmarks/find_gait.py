# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Searches the gait of the walker's demonstration by CMA-ES.

It minimises over the parameters of the SIMBICON controller

    10 (1 − share of the time walked) + (mean speed − v*)² + w_u · mean ‖u‖²,   v* = 0.8 m/s.

It needs the package `cma`: pip install -r requirements/search.txt.
"""

import argparse
import json
from dataclasses import asdict, astuple
from pathlib import Path

import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.storage.files import write_json
from vgps_ros.tasks import Task
from vgps_ros.tasks.walker.simbicon import GAIT, Gait, Pose, walk
from vgps_ros.tasks.walker.task import plain_task

TARGET_SPEED = 0.8  # of the demonstration [m/s]
FALLING = 10.0  # what a fall at once costs
# What a standard deviation of 1 in the search means: s, rad, N·m/rad, then each pose's parameters.
SCALES = np.array([0.1, 0.1, 200.0, *2 * [0.3, 0.3, 0.2, 0.2, 0.2, 0.5, 0.2]])
# A start that does not walk: an upright torso, a bent swing knee and the paper's usual feedback.
START = np.array([0.3, 0.0, 500.0, *2 * [0.3, -0.6, 0.1, -0.1, 0.1, 0.2, 0.2]])


def to_vector(gait: Gait) -> Array:
    """Returns all parameters in the order of their declaration, shape (17,)."""
    poses = [value for pose in gait.poses for value in astuple(pose)]
    return np.array([gait.duration, gait.torso, gait.torso_stiffness, *poses])


def from_vector(values: Array) -> Gait:
    """Returns the gait with these parameters."""
    duration, torso, torso_stiffness, *poses = map(float, values)
    return Gait(duration, torso, torso_stiffness, (Pose(*poses[:7]), Pose(*poses[7:])))


def gait_cost(walker: Task, gait: Gait, seconds: float) -> float:
    """Returns what a gait costs over a rollout from a stand; less is better."""
    dynamics = walker.dynamics
    steps = round(seconds / dynamics.time_step)
    walking = walk(dynamics, gait, steps)
    down = walker.fallen(walking.states) | ~np.isfinite(walking.states).all(axis=1)
    lasted = int(down.argmax()) if down.any() else steps
    if not lasted:
        return FALLING
    speed = walking.states[lasted - 1, 0] / (lasted * dynamics.time_step)
    effort = float((walking.controls[:lasted] ** 2 @ walker.cost.control_weights).mean())
    return FALLING * (1 - lasted / steps) + (speed - TARGET_SPEED) ** 2 + effort


def find_gait(start: Array, *, seconds: float, evaluations: int, seed: int) -> tuple[Gait, float]:
    """Searches a gait and returns it with its cost."""
    import cma

    walker = plain_task()

    def cost(offset: Array) -> float:
        values = start + SCALES * np.asarray(offset)
        if values[0] <= 0 or values[2] <= 0:  # a duration and a stiffness
            return 2 * FALLING
        return gait_cost(walker, from_vector(values), seconds)

    options = {"seed": seed + 1, "maxfevals": evaluations, "verbose": -9, "verb_disp": 10}
    best, _ = cma.fmin2(cost, np.zeros(len(start)), 0.3, options)
    return from_vector(start + SCALES * best), cost(best)


def main() -> None:
    """Searches the gait that the arguments describe, and writes it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of a rollout [s]")
    parser.add_argument("--evaluations", type=int, default=5000, help="rollouts at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--refine", action="store_true", help="start from the gait in use, not from a stumble"
    )
    parser.add_argument("--output", type=Path, required=True, help="JSON file for the gait")
    given = parser.parse_args()
    start = to_vector(GAIT) if given.refine else START
    gait, cost = find_gait(
        start, seconds=given.seconds, evaluations=given.evaluations, seed=given.seed
    )
    write_json(given.output, {"cost": cost, "gait": asdict(gait)})
    print(json.dumps(asdict(gait), indent=1))
    print(f"Its cost is {cost:.4f}; wrote it to {given.output}.")


if __name__ == "__main__":
    main()
