# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes and reads the table of an experiment, with a row for each iteration of each cell."""

import math
from collections import defaultdict
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any, TypeAlias, get_type_hints

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from benchmarks.figure1.cells import Cell, Panel, finished_cells
from benchmarks.figure1.curves import CURVES
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.search.metrics import METRICS, IterationMetrics
from vgps_ros.storage.files import replacing
from vgps_ros.storage.run_folder import RunFolder, read_result

# The results of one method in one panel: columns of the table by name, each of shape (S, K) for S
# seeds in ascending order and K iterations.
Columns: TypeAlias = Mapping[str, Array]

TABLE = "results"  # name of the table's files, with the endings .parquet and .csv

_KEYS = {
    "task": pa.string(),
    "hidden_units": pa.int64(),
    "method": pa.string(),
    "seed": pa.int64(),
    "iteration": pa.int64(),
}
_NUMBERS = {float: pa.float64(), int: pa.int64()}  # a metric of several numbers has no column
_TYPES = get_type_hints(IterationMetrics)
_METRICS = {name: _NUMBERS[_TYPES[name]] for name in METRICS if _TYPES[name] in _NUMBERS}
SCHEMA = pa.schema({**_KEYS, **_METRICS, "seconds": pa.float64()})


def write_table(root: Path) -> pa.Table:
    """Collects the finished cells of an experiment into results.parquet and results.csv."""
    rows = [row for cell in finished_cells(root) for row in _rows(cell, root)]
    table = pa.Table.from_pylist(rows, SCHEMA)
    for ending, write in (("parquet", pa.parquet.write_table), ("csv", pa.csv.write_csv)):
        with replacing(root / f"{TABLE}.{ending}") as file:
            write(table, file)
    return table


def read_table(root: Path) -> pa.Table:
    """Reads the table of an experiment.

    Raises:
        InvalidInputError: the table is missing, or the file is not such a table.
    """
    path = root / f"{TABLE}.parquet"
    if not path.is_file():
        raise InvalidInputError(
            f"'{root}' has no {path.name}; name the output folder of `benchmarks.figure1 run`."
        )
    try:
        table = pa.parquet.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InvalidInputError(f"'{path}' is not a Parquet table: {error}.") from error
    if not set(_KEYS) <= set(table.schema.names) or not table.num_rows:
        raise InvalidInputError(
            f"'{path}' is not the table of an experiment: it has {table.num_rows} rows and the "
            f"columns {', '.join(table.schema.names)}."
        )
    return table


def by_panel(table: pa.Table) -> dict[Panel, dict[str, Columns]]:
    """Returns the results of each panel's methods, both in the order of the paper."""
    order = list(CURVES)
    rows = [row for row in table.to_pylist() if row["method"] in CURVES]
    rows.sort(key=lambda row: [order.index(row[n]) if n == "method" else row[n] for n in _KEYS])
    found: dict[Panel, dict[str, Columns]] = defaultdict(dict)
    for (task, units, method), group in groupby(rows, lambda r: [r[n] for n in [*_KEYS][:3]]):
        own = list(group)
        seeds = len({row["seed"] for row in own})
        found[Panel(task, units)][method] = {
            name: np.array([row.get(name) for row in own], float).reshape(seeds, -1)
            for name in ("seed", *_METRICS, "seconds")
        }
    return dict(found)


def _rows(cell: Cell, root: Path) -> list[dict[str, Any]]:
    result = read_result(RunFolder(cell.folder(root)).result)
    rows, seconds = [], 0.0
    for entry in result["iterations"]:
        seconds += entry["q_step_seconds"] + entry["m_step_seconds"]
        # A cost that diverged is null in JSON and infinite here.
        own = {n: math.inf if entry[n] is None else entry[n] for n in _METRICS if n in entry}
        place = (cell.panel.task, cell.panel.hidden_units, cell.method, cell.seed, entry["k"])
        own |= dict(zip(_KEYS, place, strict=True))
        rows.append({**own, "initial_ddp_cost": result["initial_ddp_cost"], "seconds": seconds})
    return rows
