# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs the cells of an experiment in parallel, and goes on where it was stopped."""

import fcntl
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import timedelta
from pathlib import Path
from typing import Any

import joblib
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from benchmarks.figure1.cells import Cell, Protocol, remove_unfinished, run_cell
from benchmarks.figure1.table import write_table
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.files import read_json, write_json
from vgps_ros.views.console import plain_console

FAILURES = "failures.json"
_PROTOCOL = "experiment.json"


def run_experiment(
    cells: Sequence[Cell], protocol: Protocol, output: Path, backend: str, jobs: int, address: str
) -> dict[Cell, str]:
    """Trains the cells that are not finished yet, and writes the table of all that are.

    Returns:
        Why cells failed.

    Raises:
        InvalidInputError: the folder belongs to something else, or the cluster is not there; or a
            worker has died.
    """
    failures, began, console = {}, time.monotonic(), plain_console()
    with (
        workers(backend, jobs, address) as parallel,
        claimed(output, protocol),
        Progress(
            "{task.description}",
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
            speed_estimate_period=float("inf"),  # cells take minutes
            disable=not console.is_terminal,
        ) as progress,
    ):
        remove_unfinished(output)
        waiting = [cell for cell in cells if not cell.is_finished(output)]
        done = len(cells) - len(waiting)
        console.out(
            f"{len(cells)} cells, {done} of them finished before; {protocol.iterations} iterations "
            "each. Ctrl-C stops; the same command goes on.",
            highlight=False,
        )
        bar = progress.add_task("cells", total=len(cells), completed=done)
        tasks = (joblib.delayed(_run)(cell, protocol, output.absolute()) for cell in waiting)
        for cell, error in parallel(tasks):
            done += 1
            outcome = f"failed: {error}" if error else "finished"
            after = timedelta(seconds=round(time.monotonic() - began))
            console.out(f"{done}/{len(cells)} after {after}: {cell} {outcome}", highlight=False)
            progress.advance(bar)
            if error:
                failures[cell] = error
            _write(output, failures)
        _write(output, failures)
    return failures


def _write(output: Path, failures: Mapping[Cell, str]) -> None:
    """Writes the table of what has finished, and why other cells have failed if any have."""
    write_table(output)
    if failures:
        reasons = [{"cell": str(cell), "error": error} for cell, error in failures.items()]
        write_json(output / FAILURES, reasons)
    else:
        (output / FAILURES).unlink(missing_ok=True)  # of an earlier attempt


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
        found = read_json(path)
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
        InvalidInputError: there are no processes to use, an address is given but no cluster, or
            the cluster is not there.
    """
    options: dict[str, Any] = {"return_as": "generator_unordered", "batch_size": 1}
    if jobs == 0:
        raise InvalidInputError("jobs is 0, but it must be a number of processes, or -1 for all.")
    if address and backend != "dask":
        raise InvalidInputError(
            f"address is '{address}', but only the backend dask has a scheduler; add --backend "
            "dask, or leave it out."
        )
    if backend == "processes":
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


def _listed(values: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())
