"""Draws a run: its learning curve, trajectory, motion, a filmstrip, and a moving picture.

The pictures are PNG, SVG and GIF: the learning curve, the trajectory within the tubes of q, the
motion with the paths of the centre of mass. Example: vgps plot recordings/sample --output plots
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.experiments.command_line import Parser, add_overwrite, refuse_existing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from vgps_ros.views.run_record import RunRecord

_FORMATS = ("png", "svg")
_MOVING_PICTURE = "motion.gif"


def plot(source: Path, output: Path, *, overwrite: bool) -> None:
    """Draws what is known of a run.

    Args:
        source: folder of a run or of a bag.
        output: folder for the pictures.
        overwrite: whether pictures there may be replaced.

    Raises:
        VgpsError: the source cannot be read, has nothing to draw, or a picture is there already.
    """
    from vgps_ros.views.filmstrip import RenderingError, filmstrip, write_moving_picture
    from vgps_ros.views.plots import learning_curve, motion, save, trajectory

    figures: dict[str, Callable[[RunRecord], Figure | None]] = {
        "learning_curve": lambda run: learning_curve(run.result) if run.result else None,
        "trajectory": trajectory,
        "motion": motion,
        "filmstrip": filmstrip,
    }
    run = _read(source)
    names = [f"{name}.{kind}" for name in figures for kind in _FORMATS] + [_MOVING_PICTURE]
    refuse_existing([output / name for name in names], overwrite=overwrite)
    output.mkdir(parents=True, exist_ok=True)
    written, notes = [], []
    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("", total=len(figures) + 1)
        for name, draw in figures.items():
            progress.update(bar, description=name)
            try:
                if figure := draw(run):
                    for kind in _FORMATS:
                        save(figure, output / f"{name}.{kind}")
                        written.append(f"{name}.{kind}")
            except RenderingError as error:
                notes.append(f"No {name}: {error}")
            progress.advance(bar)
        progress.update(bar, description=_MOVING_PICTURE)
        try:
            if write_moving_picture(run, output / _MOVING_PICTURE):
                written.append(_MOVING_PICTURE)
        except RenderingError as error:
            notes.append(f"No {_MOVING_PICTURE}: {error}")
    if not written:
        raise InvalidInputError(f"'{source}' has neither a training nor a motion to draw.")
    print(*notes, *_absences(run), sep="\n", end="")
    print(f"Wrote {', '.join(written)} to {output}.")


def _read(source: Path) -> "RunRecord":
    """Returns the run of a folder; only a bag needs what ROS brings."""
    from vgps_ros.storage.run_folder import RunFolder
    from vgps_ros.views.run_record import read_results

    if (source / "experiment.json").is_file():
        raise InvalidInputError(
            f"'{source}' is the folder of an experiment: `vgps figure {source}` draws it, and "
            "`vgps plot` draws one of the folders in its runs/."
        )
    if (folder := RunFolder(source)).trajectories.is_file():
        return read_results(folder)
    from vgps_ros.bags.run_reader import read_run

    return read_run(source)


def _absences(run: "RunRecord") -> list[str]:
    known = {
        "No learning curve: there was no training.": run.result,
        "No tubes: there is no trajectory distribution.": run.mean_states,
        "No motion: there are no joint_states under a policy.": run.executed_states,
    }
    return [sentence for sentence, value in known.items() if value is None] + [""]


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("run", type=Path, help="folder of a run, or of a bag")
    parser.add_argument(
        "--output", type=Path, help="folder for the pictures; default RUN/plots, or BAG-plots"
    )
    add_overwrite(parser)


def run(arguments: argparse.Namespace) -> None:
    """Draws the run that the arguments name."""
    source = arguments.run.resolve()
    beside = source.with_name(f"{source.name}-plots")  # a bag's folder holds its own files only
    default = source / "plots" if (source / "result.json").is_file() else beside
    plot(arguments.run, arguments.output or default, overwrite=arguments.overwrite)
