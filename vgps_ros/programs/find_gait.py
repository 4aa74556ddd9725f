# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Searches the gait of the walker's demonstration by CMA-ES.

It needs the package `cma`: pip install -r requirements/search.txt.
"""

import argparse
import json
from dataclasses import asdict

from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Setting
from vgps_ros.experiments.command_line import Parser, refuse_existing
from vgps_ros.storage.files import write_json


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
    from vgps_ros.experiments.gait_search import START, find_gait
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
