"""Writes and reads the table of an experiment, with a row for each iteration of each cell."""

import json
import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.experiments.cells import Cell, Panel, finished_cells
from vgps_ros.search.methods import METHODS
from vgps_ros.storage.files import replacing

TABLE = "results"  # name of the table's files, with the endings .parquet and .csv

SCHEMA = pa.schema(
    [
        ("task", pa.string()),
        ("hidden_units", pa.int64()),
        ("method", pa.string()),
        ("seed", pa.int64()),
        ("iteration", pa.int64()),
        ("initial_ddp_cost", pa.float64()),
        ("ddp_cost", pa.float64()),
        ("stochastic_cost_mean", pa.float64()),
        ("stochastic_cost_median", pa.float64()),
        ("stochastic_survival", pa.float64()),
        ("deterministic_cost", pa.float64()),
        ("deterministic_survival", pa.float64()),
        ("simulator_steps", pa.int64()),
        ("seconds", pa.float64()),
    ]
)


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
            f"'{root}' has no {path.name}; name the output folder of `vgps experiment`."
        )
    try:
        table = pa.parquet.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InvalidInputError(f"'{path}' is not a Parquet table: {error}.") from error
    if table.schema.names != SCHEMA.names or not table.num_rows:
        raise InvalidInputError(
            f"'{path}' is not the table of an experiment: it has {table.num_rows} rows and the "
            f"columns {', '.join(table.schema.names)}."
        )
    return table


@dataclass(frozen=True)
class MethodResults:
    """The results of one method in one panel.

    Attributes:
        seeds: the S seeds in ascending order.
        columns: columns of the table by name, each of shape (S, K) for K iterations.
    """

    seeds: tuple[int, ...]
    columns: Mapping[str, Array]


def by_panel(table: pa.Table) -> dict[Panel, dict[str, MethodResults]]:
    """Returns the results of each panel's methods, both in the order of the paper."""
    rows: dict[Panel, dict[str, dict[int, list[dict[str, Any]]]]] = defaultdict(
        lambda: defaultdict(lambda: defaultdict(list))
    )
    for row in table.to_pylist():
        panel = Panel(row["task"], row["hidden_units"])
        rows[panel][row["method"]][row["seed"]].append(row)
    numbers = [field.name for field in SCHEMA if field.type != pa.string()]
    return {
        panel: {
            method: MethodResults(
                tuple(sorted(methods[method])),
                {
                    name: np.array(
                        [[row[name] for row in methods[method][s]] for s in sorted(methods[method])]
                    )
                    for name in numbers
                },
            )
            for method in METHODS
            if method in methods
        }
        for panel, methods in sorted(rows.items(), key=lambda item: item[0])
    }


def _rows(cell: Cell, root: Path) -> list[dict[str, Any]]:
    result = json.loads((cell.folder(root) / "result.json").read_text())
    rows, seconds = [], 0.0
    for entry in result["iterations"]:
        seconds += entry["q_step_seconds"] + entry["m_step_seconds"]
        # A cost that diverged is null in JSON and infinite in the table.
        values = {name: math.inf if value is None else value for name, value in entry.items()}
        rows.append(
            {
                **{name: values[name] for name in SCHEMA.names if name in values},
                "task": cell.panel.task,
                "hidden_units": cell.panel.hidden_units,
                "method": cell.method,
                "seed": cell.seed,
                "iteration": entry["k"],
                "initial_ddp_cost": result["initial_ddp_cost"],
                "seconds": seconds,
            }
        )
    return rows
