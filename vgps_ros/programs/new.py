# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a first task file for a robot: DIR/task.yaml, with comments that say what to change.

Example: vgps new hopper --model package://gymnasium/envs/mujoco/assets/hopper.xml
"""

import argparse
import math
import os
import shlex
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidEntryError, InvalidInputError
from vgps_ros.programs.command_line import Parser, refuse_existing

if TYPE_CHECKING:
    import mujoco


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
    from vgps_ros.simulation.model import compile_model, try_model
    from vgps_ros.simulation.model_changes import changed_spec, self_contained
    from vgps_ros.tasks.task_file import SCHEMA_PATH, find_model, shorten
    from vgps_ros.wizard.first_task import first_task_file
    from vgps_ros.wizard.model_edits import (
        foreign_bodies,
        has_motors_too_strong,
        lacks_ground,
        leg_wheels,
        root_to_free,
    )

    path = arguments.folder / "task.yaml"
    refuse_existing([path], overwrite=arguments.overwrite)
    reference = arguments.model
    try:
        found = find_model(reference, Path.cwd())
    except InvalidEntryError as error:
        raise InvalidInputError(shorten(f"--model: {error.sentence}")) from error
    if not reference.startswith("package:"):
        reference = os.path.relpath(reference, arguments.folder)
    changes = dict[str, Any]()

    def compiled(**more: Any) -> "mujoco.MjModel":
        changes.update(more)
        text = try_model(lambda: [self_contained(changed_spec(found, changes, {}))])
        return compile_model(text, is_tried=True)

    try:
        model = compiled()
    except InvalidInputError as error:  # files of meshes may be elsewhere
        words = {"visual": "what only shows", "meshes": "meshes"}
        for drop in words:
            with suppress(InvalidInputError):
                model = compiled(drop=[drop])
                break
        else:
            raise
        cause = str(error).removeprefix("model: ").partition(";")[0].rstrip(".")
        print(f"Without {words[drop]}, since {cause}.")
    if locks := _locks(arguments.lock):
        model = compiled(joints=locks)
    if base := root_to_free(model):
        model = compiled(free_bodies=[base])
    if lacks_ground(model):
        model = compiled(floor=True)
    if wheels := leg_wheels(model):
        locks |= {wheel: {"lock": 0.0} for wheel in wheels}
        model = compiled(joints=locks)
        print(f"Locked the wheels {', '.join(wheels)}, so that legs stand on them as on feet.")
    if foreign := foreign_bodies(model):
        model = compiled(remove_bodies=foreign)
    former = model
    if model.nu and (arguments.servos or has_motors_too_strong(model)):
        model = compiled(remove_actuators=["*"])
    text = first_task_file(reference, model, str(SCHEMA_PATH), changes, former)
    arguments.folder.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    name = shlex.quote(str(path))
    print(f"Wrote {path}. Next: vgps check {name}, then vgps train --task {name} --output RUN")
