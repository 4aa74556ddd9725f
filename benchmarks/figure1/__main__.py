# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reproduces Figure 1 of the paper: `run` trains every method on every panel, `plot` draws them.

Example: python -m benchmarks.figure1 run --output DIR, then python -m benchmarks.figure1 plot DIR
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.figure1.cells import PANELS, Panel, Protocol, all_cells
from benchmarks.figure1.curves import CURVES, MOST_JOBS, RISING
from benchmarks.figure1.pictures import draw_figure
from benchmarks.figure1.runner import FAILURES, run_experiment
from benchmarks.figure1.table import TABLE
from vgps_ros.core.errors import VgpsError
from vgps_ros.core.settings import Range, Setting, settings_of
from vgps_ros.programs.command_line import Parser
from vgps_ros.search.settings import SearchSettings
from vgps_ros.simulation.warnings import silence_mujoco


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program, and ends with a sentence where it fails."""
    silence_mujoco()
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = Parser(prog="figure1", description=__doc__, words=words)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, add, text in (
        ("run", _add_run_arguments, "trains every method on every panel, over several seeds"),
        ("plot", _add_plot_arguments, "draws the table of `run`: pictures, a recording, summaries"),
    ):
        add(commands.add_parser(name, help=text, description=text, words=words[1:]))
    parsed = parser.parse_args(words)
    try:
        parsed.run(parsed)
    except (VgpsError, OSError) as error:
        sys.exit(f"{parsed.parser.prog}: {error}")
    except KeyboardInterrupt:
        sys.exit(f"{parsed.parser.prog}: {parsed.interrupted}")


def _add_run_arguments(parser: Parser) -> None:
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
        Setting("seeds", 10, Range(1, 100_000), "number of seeds"),
        Setting("first_seed", 0, Range(0, 100_000), "the lowest of them"),
        *(
            Setting(s.name, s.default, Range(1, 100_000), f"{s.description}, of a cell")
            for s in settings_of(SearchSettings(evaluation_rollouts=20))
            if s.name in ("iterations", "evaluation_rollouts")
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
        Setting("jobs", -1, Range(-1, MOST_JOBS), "processes at once; -1: one a core")
    )
    parser.add_argument(
        "--address",
        default="",
        help="Dask scheduler, such as tcp://host:8786; its workers must see --output under the "
        "same path",
    )
    parser.set_defaults(
        run=_run, interrupted="interrupted; the same command goes on with what is left."
    )


def _add_plot_arguments(parser: Parser) -> None:
    parser.add_argument("experiment", type=Path, help="output folder of `run`")
    parser.add_output("--output", "folder for the pictures; default: the same")
    parser.add_argument(
        "--average",
        choices=("mean", "median"),
        default="mean",
        help="of a policy's stochastic rollouts; a walker that thrashes after its fall outweighs "
        "all others in the mean",
    )
    parser.set_defaults(run=_plot)


def _run(arguments: argparse.Namespace) -> None:
    """Trains every method on every panel; goes on where it was stopped, and tries failures anew."""
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
    print(
        f"Wrote {TABLE}.parquet and {TABLE}.csv to {output}; `python -m benchmarks.figure1 plot "
        f"{output}` draws them."
    )
    if failures:
        raise VgpsError(f"{len(failures)} cells failed; {output / FAILURES} says why.")


def _plot(arguments: argparse.Namespace) -> None:
    output = arguments.output or arguments.experiment
    draw_figure(
        arguments.experiment, output, average=arguments.average, overwrite=arguments.overwrite
    )


if __name__ == "__main__":
    main()
