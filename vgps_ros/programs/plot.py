# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Draws a run: its learning curve, trajectory, motion, a filmstrip, and a moving picture.

The pictures are PNG, SVG and GIF: the learning curve, the trajectory within the tubes of q, the
motion with the paths of the centre of mass, and what was driven beside what was commanded.
Example: vgps plot recordings/sample --output plots
"""

import argparse
from pathlib import Path

from vgps_ros.core.checks import printable
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.programs.command_line import Parser, refuse_existing
from vgps_ros.storage.run_folder import RunFolder


def plot(source: Path, output: Path, *, overwrite: bool, namespace: str | None = None) -> None:
    """Draws what is known of a run, which is the folder of a run or of a bag.

    Raises:
        VgpsError: the source cannot be read, has nothing to draw, or a picture is there already.
    """
    from matplotlib.figure import Figure
    from rich.console import Console
    from rich.progress import Progress

    from vgps_ros.search.run_record import read_results
    from vgps_ros.views.filmstrip import RenderingError, filmstrip, write_moving_picture
    from vgps_ros.views.learning_curve import learning_curve
    from vgps_ros.views.plots import driving, motion, save, trajectory

    if (folder := RunFolder(source)).trajectories.is_file():
        run = read_results(folder)
    else:
        from vgps_ros.bags.run_reader import read_run  # needs ROS

        run = read_run(source, namespace)
    moving = "motion.gif"
    pictures = {
        "learning_curve": lambda: learning_curve(run.result) if run.result else None,
        "trajectory": lambda: trajectory(run),
        "motion": lambda: motion(run),
        "driven": lambda: driving(run.driven) if run.driven else None,
        "filmstrip": lambda: filmstrip(run),
        moving: lambda: write_moving_picture(run, output / moving),
    }
    names = {name: [f"{name}.png", f"{name}.svg"] for name in pictures} | {moving: [moving]}
    refuse_existing(
        [output / file for files in names.values() for file in files], overwrite=overwrite
    )
    output.mkdir(parents=True, exist_ok=True)
    written, notes = [], [f"Not whole: {sentence}." for sentence in run.faults]
    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("", total=len(pictures))
        for name, draw in pictures.items():
            progress.update(bar, description=name)
            try:
                if drawn := draw():
                    written += names[name]
                    if isinstance(drawn, Figure):
                        for file in names[name]:
                            save(drawn, output / file)
            except RenderingError as error:
                notes.append(f"No {name}: {error}")
            progress.advance(bar)
    if not written:
        raise InvalidInputError(f"'{source}' has neither a training nor a motion to draw.")
    known = {
        "No learning curve: there was no training.": run.result,
        "No tubes: there is no trajectory distribution.": run.mean_states,
        "No motion: there are no joint_states under a policy.": run.executed_states,
    }
    notes += [sentence for sentence, value in known.items() if value is None]
    print(*map(printable, notes), f"Wrote {', '.join(written)} to {output}.", sep="\n")


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("run", type=Path, help="folder of a run, or of a bag")
    parser.add_namespace("of the robot that is drawn, for a bag of several")
    parser.add_output("--output", "folder for the pictures; default RUN/plots, or BAG-plots")


def run(arguments: argparse.Namespace) -> None:
    """Draws the run that the arguments name."""
    source = arguments.run.resolve()
    beside = source.with_name(f"{source.name}-plots")  # a bag's folder holds its own files only
    default = source / "plots" if (source / "result.json").is_file() else beside
    output = arguments.output or default
    plot(arguments.run, output, overwrite=arguments.overwrite, namespace=arguments.namespace)
