"""Program `experiment`: trains every method on every panel of Figure 1, over several seeds."""

import argparse
import fcntl
import json
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import joblib
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from vgps_ros.core.checks import one_of, positive
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.experiments.cell_table import TABLE, write_table
from vgps_ros.experiments.cells import (
    PANELS,
    Cell,
    Panel,
    Protocol,
    all_cells,
    remove_unfinished,
    run_cell,
)
from vgps_ros.search.methods import METHODS
from vgps_ros.storage.files import write_json

BACKENDS = ("processes", "dask")
_PROTOCOL = "experiment.json"


def experiment(
    cells: Sequence[Cell], protocol: Protocol, output: Path, backend: str, jobs: int, address: str
) -> dict[Cell, str]:
    """Trains the cells that are not finished yet, and writes the table of all that are.

    Returns:
        Why cells failed.

    Raises:
        InvalidInputError: the folder belongs to something else, or the cluster is not there.
    """
    failures = {}
    with (
        workers(backend, jobs, address) as parallel,
        claimed(output, protocol),
        _progress() as progress,
    ):
        remove_unfinished(output)
        waiting = [cell for cell in cells if not cell.is_finished(output)]
        done = len(cells) - len(waiting)
        progress.console.print(
            f"{len(cells)} cells, {done} of them finished before; {protocol.iterations} iterations "
            "each. Ctrl-C stops; the same command goes on.",
            highlight=False,
            soft_wrap=True,
        )
        bar = progress.add_task("cells", total=len(cells), completed=done)
        for cell, error in parallel(
            joblib.delayed(_run)(cell, protocol, output.absolute()) for cell in waiting
        ):
            outcome = f"failed: {error}" if error else "finished"
            progress.console.print(f"{cell} {outcome}", highlight=False, soft_wrap=True)
            progress.advance(bar)
            if error:
                failures[cell] = error
            _write(output, failures)
        _write(output, failures)
    return failures


def _write(output: Path, failures: Mapping[Cell, str]) -> None:
    """Writes the table of what has finished, and why other cells have failed."""
    write_table(output)
    reasons = [{"cell": str(cell), "error": error} for cell, error in failures.items()]
    write_json(output / "failures.json", reasons)


@contextmanager
def claimed(output: Path, protocol: Protocol) -> Iterator[None]:
    """Keeps a folder for this experiment alone.

    Raises:
        InvalidInputError: it belongs to an experiment with another protocol, to one that is running
            now, or to something else.
    """
    path = output / _PROTOCOL
    if not output.exists() or (output.is_dir() and not any(output.iterdir())):
        output.mkdir(parents=True, exist_ok=True)
        write_json(path, asdict(protocol))
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InvalidInputError(
            f"'{output}' is not the folder of an experiment; name another --output."
        ) from error
    if found != asdict(protocol):
        raise InvalidInputError(
            f"'{output}' belongs to an experiment with {_listed(found)}, but this one has "
            f"{_listed(asdict(protocol))}; name another --output."
        )
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InvalidInputError(
                f"An experiment is running in '{output}' now; wait for its end."
            ) from error
        yield


@contextmanager
def workers(backend: str, jobs: int, address: str) -> Iterator[joblib.Parallel]:
    """Gives what runs cells in parallel and yields each as it ends.

    Raises:
        InvalidInputError: the backend is unknown, or the cluster is not there.
    """
    options: dict[str, Any] = {"return_as": "generator_unordered", "batch_size": 1}
    if jobs == 0:
        raise InvalidInputError("jobs is 0, but it must be a number of processes, or -1 for all.")
    if one_of("backend", backend, BACKENDS) == "processes":
        yield joblib.Parallel(n_jobs=jobs, **options)
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise InvalidInputError(
            "The dask backend needs more: pip install -r requirements/cluster.txt."
        ) from error
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise InvalidInputError(
            f"No Dask scheduler answers at '{address}'; give the --address it was started with."
        ) from error
    with client, joblib.parallel_config(backend="dask"):
        yield joblib.Parallel(n_jobs=-1, **options)


def _run(cell: Cell, protocol: Protocol, root: Path) -> tuple[Cell, str]:
    return cell, run_cell(cell, protocol, root)


def _progress() -> AbstractContextManager[Progress]:
    console = Console()
    return Progress(
        "{task.description}",
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        speed_estimate_period=float("inf"),  # cells take minutes
        disable=not console.is_terminal,
    )


def _listed(values: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    parser = argparse.ArgumentParser(
        prog="experiment",
        description="Trains every method on every panel over several seeds, and writes "
        f"{TABLE}.parquet and {TABLE}.csv. Started again it goes on where it was stopped; cells "
        "that failed are tried again.",
    )
    parser.add_argument(
        "--panels",
        nargs="+",
        default=["all"],
        help=f"all ({', '.join(PANELS)}) or TASK-UNITS, such as walker-10",
    )
    parser.add_argument(
        "--methods", nargs="+", default=["all"], help=f"all, or some of {', '.join(METHODS)}"
    )
    parser.add_argument("--seeds", type=int, default=10, help="seeds 0 to this number less one")
    parser.add_argument("--iterations", type=int, default=50, help="policy updates of each cell")
    parser.add_argument(
        "--evaluation-rollouts", type=int, default=20, help="stochastic rollouts an iteration"
    )
    parser.add_argument("--output", type=Path, required=True, help="folder for all results")
    parser.add_argument(
        "--backend", default="processes", help="processes of this machine, or dask for a cluster"
    )
    parser.add_argument("--jobs", type=int, default=-1, help="processes at once; -1: one a core")
    parser.add_argument(
        "--address", default="", help="Dask scheduler, such as tcp://host:8786; its workers must "
        "see --output under the same path"
    )  # fmt: skip
    parsed = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # it stops the workers too
    try:
        for name in ("seeds", "iterations", "evaluation_rollouts"):
            positive(name, getattr(parsed, name))
        panels = PANELS if parsed.panels == ["all"] else parsed.panels
        methods = list(METHODS) if parsed.methods == ["all"] else parsed.methods
        failures = experiment(
            all_cells([Panel.named(name) for name in panels], methods, parsed.seeds),
            Protocol.of(parsed.iterations, parsed.evaluation_rollouts),
            parsed.output,
            parsed.backend,
            parsed.jobs,
            parsed.address,
        )
    except (VgpsError, OSError) as error:
        sys.exit(f"experiment: {error}")
    except RuntimeError as error:  # of joblib
        sys.exit(f"experiment: a worker has died; the same command goes on. {error}")
    except KeyboardInterrupt:
        sys.exit("experiment: interrupted; the same command goes on with what is left.")
    print(f"Wrote {TABLE}.parquet and {TABLE}.csv to {parsed.output}; "
          f"`ros2 run vgps_ros figure {parsed.output}` draws them.")  # fmt: skip
    if failures:
        sys.exit(
            f"experiment: {len(failures)} cells failed; {parsed.output}/failures.json says why."
        )
