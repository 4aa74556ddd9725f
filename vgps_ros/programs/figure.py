# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Draws an experiment as Figure 1 of the paper, and sums it up in a table.

It writes figure1.png, figure1.svg, the Rerun recording figure1.rrd, and the table as summary.csv.
"""

import argparse
from pathlib import Path

from vgps_ros.experiments.command_line import Parser


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("experiment", type=Path, help="output folder of `vgps experiment`")
    parser.add_output("--output", "folder for the pictures; default: the same")
    parser.add_argument(
        "--average",
        choices=("mean", "median"),
        default="mean",
        help="of a policy's stochastic rollouts; a walker that thrashes after its fall outweighs "
        "all others in the mean",
    )


def run(arguments: argparse.Namespace) -> None:
    """Draws the experiment that the arguments name."""
    from vgps_ros.experiments.figure1 import draw_figure

    output = arguments.output or arguments.experiment
    draw_figure(
        arguments.experiment, output, average=arguments.average, overwrite=arguments.overwrite
    )
