# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trains every method on every panel of Figure 1, over several seeds.

It writes results.parquet and results.csv. Started again it goes on where it was stopped; cells that
failed are tried again.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.settings import Setting, settings_of
from vgps_ros.experiments.command_line import Parser
from vgps_ros.experiments.paper import CURVES, MOST_JOBS, RISING
from vgps_ros.search.settings import SearchSettings


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument(
        "--panels", nargs="+", default="all", help="all, or TASK-UNITS such as walker-10"
    )
    parser.add_argument(
        "--methods",
        nargs="+",
        default="all",
        help=f"all, or some of {', '.join(CURVES)}; {RISING} is vgps with the tasks' own settings",
    )
    parser.add_settings(
        Setting("seeds", 10, "number of seeds", minimum=1, maximum=100_000),
        Setting("first_seed", 0, "the lowest of them", minimum=0, maximum=100_000),
        *(
            replace(setting, description=f"{setting.description}, of a cell")
            for setting in settings_of(SearchSettings())
            if setting.name in ("iterations", "evaluation_rollouts")
        ),
    )
    parser.add_argument("--output", type=Path, required=True, help="folder for all results")
    parser.add_argument(
        "--backend",
        choices=("processes", "dask"),
        default="processes",
        help="processes of this machine, or dask for a cluster",
    )
    parser.add_settings(
        Setting("jobs", -1, "processes at once; -1: one a core", minimum=-1, maximum=MOST_JOBS)
    )
    parser.add_argument(
        "--address",
        default="",
        help="Dask scheduler, such as tcp://host:8786; its workers must see --output under the "
        "same path",
    )
    parser.set_defaults(interrupted="interrupted; the same command goes on with what is left.")


def run(arguments: argparse.Namespace) -> None:
    """Runs the experiment that the arguments describe."""
    from vgps_ros.experiments.cell_runner import FAILURES, run_experiment
    from vgps_ros.experiments.cell_table import TABLE
    from vgps_ros.experiments.cells import PANELS, Panel, Protocol, all_cells

    panels = PANELS if arguments.panels in ("all", ["all"]) else arguments.panels
    methods = CURVES if arguments.methods in ("all", ["all"]) else arguments.methods
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    output = arguments.output
    try:
        failures = run_experiment(
            all_cells([Panel.named(name) for name in panels], methods, seeds),
            Protocol.of(arguments.iterations, arguments.evaluation_rollouts),
            output,
            arguments.backend,
            arguments.jobs,
            arguments.address,
        )
    except RuntimeError as error:  # of joblib
        raise VgpsError(f"A worker has died; the same command goes on. {error}") from error
    print(f"Wrote {TABLE}.parquet and {TABLE}.csv to {output}; `vgps figure {output}` draws them.")
    if failures:
        raise VgpsError(f"{len(failures)} cells failed; {output / FAILURES} says why.")
