# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes the motions of bags as a data set, for learning from them elsewhere.

Each row is a step: the state, and the control that was chosen in it. An episode ends at a reset and
where states or controls are missing.
"""

import argparse
import re
import sys
from pathlib import Path
from typing import Literal

from vgps_ros.core.checks import printable
from vgps_ros.core.settings import Setting
from vgps_ros.programs.command_line import Parser

_FORMAT = Setting(
    "format",
    "parquet",
    "parquet: one table, motions.parquet, in float64; lerobot: a LeRobotDataset of version 3",
    kind=Literal["parquet", "lerobot"],
)
_LARGEST = 4096  # width or height of a picture [pixels]


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="folders of bags")
    parser.add_output("--output", "folder to write, empty, new or a data set", required=True)
    parser.add_settings(_FORMAT)
    parser.add_argument(
        "--pictures",
        type=_size,
        metavar="WIDTHxHEIGHT",
        help="render a picture of each state, of this size, such as 320x240; lerobot only",
    )
    parser.add_namespace("of the robot that is meant, for bags of several")


def run(arguments: argparse.Namespace) -> None:
    """Writes the data set."""
    if arguments.pictures and arguments.format != "lerobot":
        arguments.parser.error("--pictures needs --format lerobot")
    from vgps_ros.bags.data_sets import new_folder, read_data_set, write_parquet
    from vgps_ros.bags.lerobot_format import write_lerobot

    with new_folder(arguments.output, overwrite=arguments.overwrite) as folder:
        data = read_data_set(arguments.bags, arguments.namespace)
        if arguments.format == "parquet":
            write_parquet(data, folder)
        else:
            write_lerobot(data, folder, arguments.pictures)
    for sentence in data.faults:
        print(printable(f"Not whole: {sentence}."), file=sys.stderr)
    print(
        f"Wrote {len(data.motions)} episodes with {sum(data.lengths)} steps in all to "
        f"{arguments.output}."
    )


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if not found or not all(16 <= int(n) <= _LARGEST for n in found.groups()):
        raise argparse.ArgumentTypeError(
            f"'{text}' must be a width and a height in pixels, from 16 to {_LARGEST}, as 320x240"
        )
    return int(found[1]), int(found[2])
