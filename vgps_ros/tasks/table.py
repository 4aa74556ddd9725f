# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A table of numbers over time, in a file of comma-separated values with a header."""

import csv
from pathlib import Path

import numpy as np

from vgps_ros.core.checks import finite_array, nearest, quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array


def read_rows(path: Path) -> tuple[list[str], Array]:
    """Returns the header and the rows, shape (rows, columns).

    Raises:
        InvalidInputError: the file is not readable as a table of numbers.
    """
    try:
        with path.open(newline="") as file:
            header, *rows = csv.reader(file)
        names = [name.strip() for name in header]
        return names, np.array(rows, dtype=float).reshape(len(rows), len(names))
    except (OSError, ValueError, csv.Error) as error:
        raise InvalidInputError(f"{path} is not a readable table of numbers: {error}.") from error


def read_table(path: Path, names: list[str], times: Array) -> Array:
    """Returns the named columns at some times, linear between rows, shape (times, names).

    Before the first row and after the last one, their values hold.

    Raises:
        InvalidInputError: a column is missing, or time does not increase.
    """
    header, rows = read_rows(path)
    for name in ("time", *names):
        if name not in header:
            raise InvalidInputError(
                f"{path.name} has no column {quoted(name)}.{nearest(name, header)}"
            )
    table = finite_array(path.name, rows, rows.shape)
    when = table[:, header.index("time")]
    if not when.size or (np.diff(when) <= 0).any():
        raise InvalidInputError(f"The column 'time' of {path.name} must have rows that increase.")
    columns = [np.interp(times, when, table[:, header.index(name)]) for name in names]
    return np.stack(columns, axis=1)
