# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a first task file for a robot: DIR/task.yaml, with comments that say what to change.

Example: vgps new hopper --model package://gymnasium/envs/mujoco/assets/hopper.xml
"""

import argparse
import math
import os
import shlex
from pathlib import Path
from typing import Any

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidEntryError, InvalidInputError
from vgps_ros.programs.command_line import Parser, refuse_existing


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of this command."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of the task")
    parser.add_argument(
        "--model", required=True, help="the robot's MJCF or URDF: a path, or package://PACKAGE/PATH"
    )
    parser.add_argument(
        "--lock",
        nargs="+",
        default=[],
        metavar="JOINT[=AT]",
        help="joints that shall not move, by name or pattern, each at a position [rad, m] or 0; "
        "of several that match, the last counts: --lock 'arm_*' arm_elbow=1.5",
    )
    parser.add_argument(
        "--servos",
        action="store_true",
        help="servos of positions in place of the robot's own actuators, as strong as they are; "
        "legs whose motors would shake them get them anyway",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace DIR/task.yaml")


def _locks(given: list[str]) -> dict[str, Any]:
    """Returns the locks as `changes: {joints: ...}` has them."""
    found = dict[str, Any]()
    for entry in given:
        name, _, at = entry.partition("=")
        try:
            place = float(at or 0.0)
        except ValueError:
            place = math.nan
        if not math.isfinite(place):
            raise InvalidInputError(
                f"--lock: {quote(at)} is no position of {quote(name)}; give a number, as in "
                f"{name}=0.5."
            )
        found[name] = {"lock": place}
    return found


def run(arguments: argparse.Namespace) -> None:
    """Writes the file."""
    from vgps_ros.tasks.task_file import SCHEMA_PATH, find_model, shorten
    from vgps_ros.wizard.first_task import first_task_file
    from vgps_ros.wizard.model_edits import edit_model

    path = arguments.folder / "task.yaml"
    refuse_existing([path], overwrite=arguments.overwrite)
    reference = arguments.model
    try:
        found = find_model(reference, Path.cwd())
    except InvalidEntryError as error:
        raise InvalidInputError(shorten(f"--model: {error.sentence}")) from error
    if not reference.startswith("package:"):
        reference = os.path.relpath(reference, arguments.folder)
    locks = _locks(arguments.lock)
    try:
        edited = edit_model(found, locks, servos=arguments.servos)
    except InvalidInputError as error:  # one about a joint is about a lock
        said = str(error)
        for flag in arguments.lock:
            said = said.replace(f"changes.joints.{flag.partition('=')[0]}: ", f"--lock {flag}: ")
        raise InvalidInputError(said) from error
    for note in edited.notes:
        print(note)
    text = first_task_file(reference, edited, str(SCHEMA_PATH))
    arguments.folder.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    name = shlex.quote(str(path))
    print(f"Wrote {path}. Next: vgps check {name}, then vgps train --task {name} --output RUN")
