"""Draws an experiment as Figure 1 of the paper, and sums it up in a table.

It writes figure1.png, figure1.svg, the Rerun recording figure1.rrd, and the table as summary.csv.
"""

import argparse
from pathlib import Path

from vgps_ros.experiments.command_line import Parser, add_overwrite


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("experiment", type=Path, help="output folder of `vgps experiment`")
    parser.add_argument("--output", type=Path, help="folder for the pictures; default: the same")
    parser.add_argument(
        "--average",
        choices=("mean", "median"),
        default="mean",
        help="of a policy's stochastic rollouts; a walker that thrashes after its fall outweighs "
        "all others in the mean",
    )
    add_overwrite(parser)


def run(arguments: argparse.Namespace) -> None:
    """Draws the experiment that the arguments name."""
    from vgps_ros.experiments.figure1 import FILES, draw_figure
    from vgps_ros.experiments.summary import summary_table
    from vgps_ros.views.table_console import table_console

    output = arguments.output or arguments.experiment
    rows = draw_figure(
        arguments.experiment, output, average=arguments.average, overwrite=arguments.overwrite
    )
    table_console(wide=True).print(summary_table(rows))
    print(f"Wrote {', '.join(FILES)} to {output}.")
