"""Program `plot`: pictures of a run, for reading without a viewer."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import Progress

from vgps_ros.bags.run_reader import read_run
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.views.filmstrip import RenderingError, filmstrip, write_moving_picture
from vgps_ros.views.plots import learning_curve, motion, save, trajectory
from vgps_ros.views.run_record import RunRecord

_FIGURES: dict[str, Callable[[RunRecord], Figure | None]] = {
    "learning_curve": lambda run: learning_curve(run.result) if run.result else None,
    "trajectory": trajectory,
    "motion": motion,
    "filmstrip": filmstrip,
}
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
    run = read_run(source)
    names = [f"{name}.{kind}" for name in _FIGURES for kind in _FORMATS] + [_MOVING_PICTURE]
    existing = [output / name for name in names if (output / name).exists()]
    if existing and not overwrite:
        raise InvalidInputError(
            f"'{existing[0]}' exists already; name another --output, or give --overwrite."
        )
    output.mkdir(parents=True, exist_ok=True)
    written, notes = [], []
    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("", total=len(_FIGURES) + 1)
        for name, draw in _FIGURES.items():
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


def _absences(run: RunRecord) -> list[str]:
    known = {
        "No learning curve: there was no training.": run.result,
        "No tubes: there is no trajectory distribution.": run.mean_states,
        "No motion: there are no joint_states under a policy.": run.executed_states,
    }
    return [sentence for sentence, value in known.items() if value is None] + [""]


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    parser = argparse.ArgumentParser(
        prog="plot",
        description="Draws a run as PNG and SVG: the learning curve, the trajectory within the "
        "tubes of q, the motion with the paths of the centre of mass, a filmstrip; and a GIF.",
        epilog="example: plot recordings/sample --output plots",
    )
    parser.add_argument("run", type=Path, help="folder of a run, or of a bag")
    parser.add_argument(
        "--output", type=Path, help="folder for the pictures; default RUN/plots, or BAG-plots"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace pictures that are there")
    parsed = parser.parse_args(arguments)
    try:
        run = parsed.run.resolve()
        beside = run.with_name(f"{run.name}-plots")  # nothing but a bag's own files in its folder
        default = run / "plots" if RunFolder(run).result.is_file() else beside
        plot(parsed.run, parsed.output or default, overwrite=parsed.overwrite)
    except (VgpsError, OSError) as error:
        sys.exit(f"plot: {error}")
    except KeyboardInterrupt:
        sys.exit("plot: interrupted.")
