# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Measures over seeds, tasks and settings: a line of JSON for each, written as it comes.

What has a line already is not measured again, so a sweep that was stopped goes on. It runs in this
process, or on an executor such as a cluster's.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.search.seed_statistics import interquartile_mean, with_interval

Row = dict[str, Any]


def read_rows(file: Path) -> list[Row]:
    """Returns the lines of a file; none where it is not there yet."""
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def sweep(
    file: Path,
    names: Sequence[str],
    runs: Iterable[Sequence[Any]],
    measure: Callable[..., Row],
    executor: Executor | None = None,
) -> Iterator[Row]:
    """Measures what has no line yet, and yields each line once it is written.

    Args:
        file: of the lines.
        names: keys of a line by which it is known, such as task and seed.
        runs: the values of these, for each run in turn; `measure` takes them.
        measure: returns the line of a run.
        executor: where to measure, side by side; None: here, one after another.
    """
    known = {tuple(row[name] for name in names) for row in read_rows(file)}
    missing = [run for run in dict.fromkeys(map(tuple, runs)) if run not in known]
    submit = executor.submit if executor else _done
    ends = as_completed if executor else iter
    for future in ends(submit(measure, *run) for run in missing):
        row = future.result()
        with file.open("a") as out:
            out.write(json.dumps(row) + "\n")
        yield row


def _done(measure: Callable[..., Row], *run: Any) -> "Future[Row]":
    """Measures now."""
    future = Future[Row]()
    future.set_result(measure(*run))
    return future


def table(rows: Iterable[Row], names: Sequence[str], figure: Callable[[Row], float]) -> str:
    """Returns interquartile means of a figure over the seeds of each group, with intervals of 95 %.

    Args:
        rows: lines of a sweep.
        names: keys that name a group.
        figure: of a line.
    """

    def group(row: Row) -> tuple[str, ...]:
        return tuple(str(row[name]) for name in names)

    lines = [f"| {' | '.join(names)} | seeds | mean (95 %) |", "| --- " * (len(names) + 2) + "|"]
    for key, own in groupby(sorted(rows, key=group), group):
        values = np.array([figure(row) for row in own], dtype=float)
        band = with_interval(interquartile_mean, values)
        shown = f"{band.middle:.3g} ({band.low:.3g} to {band.high:.3g})"
        lines.append(f"| {' | '.join(key)} | {len(values)} | {shown} |")
    return "\n".join(lines)
