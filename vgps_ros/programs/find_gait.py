# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Searches the gait of the walker's demonstration by CMA-ES.

It minimises over the parameters of the SIMBICON controller

    10 (1 − share of the time walked) + (mean speed − v*)² + w_u · mean ‖u‖²,   v* = 0.8 m/s.

It needs the package `cma`: pip install -r requirements/search.txt.
"""

import argparse
import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Setting
from vgps_ros.programs.command_line import Parser, refuse_existing
from vgps_ros.storage.files import write_json

if TYPE_CHECKING:
    from vgps_ros.tasks.task import Task
    from vgps_ros.tasks.walker.simbicon import Gait

TARGET_SPEED = 0.8  # of the demonstration [m/s]
FALLING = 10.0  # what a fall at once costs
# What a standard deviation of 1 in the search means: s, rad, N·m/rad, then each pose's parameters.
SCALES = np.array([0.1, 0.1, 200.0, *2 * [0.3, 0.3, 0.2, 0.2, 0.2, 0.5, 0.2]])
# A start that does not walk: an upright torso, a bent swing knee and the paper's usual feedback.
START = np.array([0.3, 0.0, 500.0, *2 * [0.3, -0.6, 0.1, -0.1, 0.1, 0.2, 0.2]])


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_settings(
        Setting("seconds", 10.0, "length of a rollout [s]", minimum=0.1, maximum=1e4),
        Setting("evaluations", 5000, "rollouts at most", minimum=1, maximum=10_000_000),
        SEED,
    )
    parser.add_argument(
        "--refine", action="store_true", help="start from the gait in use, not from a stumble"
    )
    parser.add_output("--output", "JSON file for the gait", required=True)


def run(arguments: argparse.Namespace) -> None:
    """Searches the gait, and writes it."""
    refuse_existing([arguments.output], overwrite=arguments.overwrite)
    from vgps_ros.tasks.walker.simbicon import GAIT

    gait, cost = find_gait(
        GAIT.to_vector() if arguments.refine else START,
        seconds=arguments.seconds,
        evaluations=arguments.evaluations,
        seed=arguments.seed,
    )
    write_json(arguments.output, {"cost": cost, "gait": asdict(gait)})
    print(json.dumps(asdict(gait), indent=1))
    print(f"Its cost is {cost:.4f}; wrote it to {arguments.output}.")


def gait_cost(walker: "Task", gait: "Gait", seconds: float) -> float:
    """Returns what a gait costs over a rollout from a stand; less is better."""
    from vgps_ros.tasks.walker.simbicon import walk

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


def find_gait(start: Array, *, seconds: float, evaluations: int, seed: int) -> tuple["Gait", float]:
    """Searches a gait and returns it with its cost.

    Raises:
        VgpsError: the package `cma` is missing.
    """
    try:
        import cma
    except ImportError as error:
        raise VgpsError("It needs cma: pip install -r requirements/search.txt.") from error
    from vgps_ros.tasks.walker.simbicon import Gait
    from vgps_ros.tasks.walker.task import plain_task

    walker = plain_task()

    def cost(offset: Array) -> float:
        values = start + SCALES * np.asarray(offset)
        if values[0] <= 0 or values[2] <= 0:  # a duration and a stiffness
            return 2 * FALLING
        return gait_cost(walker, Gait.from_vector(values), seconds)

    options = {"seed": seed + 1, "maxfevals": evaluations, "verbose": -9, "verb_disp": 10}
    best, _ = cma.fmin2(cost, np.zeros(len(start)), 0.3, options)
    return Gait.from_vector(start + SCALES * best), cost(best)
