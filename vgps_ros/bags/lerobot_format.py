# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes motions as a LeRobotDataset of version 3, which LeRobot opens without a conversion.

`observation.state` is the whole state, `action` the control that was chosen in it, and
`observation.images.robot`, where it is asked for, a picture that MuJoCo renders of the state.
"""

import io
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from PIL import Image

from vgps_ros.bags.data_sets import DataSet
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.storage.files import write_json
from vgps_ros.views.filmstrip import frames

_FILE = "chunk-000/file-000.parquet"
_PICTURE = "observation.images.robot"
_COUNTS = ("frame_index", "episode_index", "index", "task_index")
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


def write_lerobot(data: DataSet, folder: Path, size: tuple[int, int] | None) -> None:
    """Writes the data set.

    Args:
        data: the motions.
        folder: an empty folder.
        size: width and height of the pictures [pixels]; None for no pictures.

    Raises:
        InvalidInputError: the states do not come at a whole number a second.
        RenderingError: MuJoCo cannot draw without a screen here.
    """
    rate = round(1.0 / data.time_step)
    if not np.isclose(rate * data.time_step, 1.0, rtol=1e-2):
        raise InvalidInputError(
            f"The states come each {data.time_step:g} s, but LeRobot needs a whole number of them "
            "a second; write the format parquet."
        )
    robot = data.model.names.partition(b"\0")[0].decode() or "robot"
    columns, counted = _columns(data, rate), np.cumsum([0, *data.lengths])
    statistics = [
        {name: _statistics(values[begin:end]) for name, values in columns.items()}
        for begin, end in pairwise(counted)
    ]
    table = {name: _arrow(values) for name, values in columns.items()}
    if size:
        table[_PICTURE], of_pictures = _pictures(data, size)
        statistics = [s | {_PICTURE: p} for s, p in zip(statistics, of_pictures, strict=True)]
    _write(folder / "data" / _FILE, pa.table(table))
    _write(folder / "meta" / "episodes" / _FILE, _episodes(data, statistics, robot))
    _write(folder / "meta" / "tasks.parquet", _tasks(robot))
    write_json(folder / "meta" / "stats.json", _merge_statistics(statistics))
    write_json(folder / "meta" / "info.json", _info(data, rate, robot, size))


def _columns(data: DataSet, rate: int) -> dict[str, Array]:
    states, controls = data.stacked()
    frame = np.concatenate([np.arange(n) for n in data.lengths])
    return {
        "observation.state": states.astype(np.float32),
        "action": controls.astype(np.float32),
        "timestamp": (frame / rate).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.repeat(np.arange(len(data.motions)), data.lengths),
        "index": np.arange(len(frame)),
        "task_index": np.zeros(len(frame), dtype=np.int64),
    }


def _arrow(values: Array) -> Any:
    """Returns a column: of numbers, or of rows with as many numbers each."""
    if values.ndim == 1 or values.shape[1] == 1:
        return pa.array(values.ravel())
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _statistics(values: Array) -> dict[str, Any]:
    rows = values.reshape(len(values), -1).astype(float)
    quantiles = np.quantile(rows, list(_QUANTILES.values()), axis=0)
    return {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": rows.mean(axis=0).tolist(),
        "std": rows.std(axis=0).tolist(),
        "count": [len(rows)],
        **dict(zip(_QUANTILES, quantiles.tolist(), strict=True)),
    }


def _merge_statistics(statistics: list[dict[str, dict[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Returns the statistics of all episodes; their quantiles are means of the episodes'."""
    counts = np.array([each["index"]["count"][0] for each in statistics], dtype=float)
    merged = {}
    for name in statistics[0]:
        of = {
            key: np.array([each[name][key] for each in statistics]) for key in statistics[0][name]
        }
        shape = (-1, *[1] * (of["mean"].ndim - 1))
        weights = (counts / counts.sum()).reshape(shape)
        mean = (weights * of["mean"]).sum(axis=0)
        variance = (weights * (of["std"] ** 2 + (of["mean"] - mean) ** 2)).sum(axis=0)
        merged[name] = {
            "min": of["min"].min(axis=0).tolist(),
            "max": of["max"].max(axis=0).tolist(),
            "mean": mean.tolist(),
            "std": np.sqrt(variance).tolist(),
            "count": [int(counts.sum())],
            **{key: (weights * of[key]).sum(axis=0).tolist() for key in _QUANTILES},
        }
    return merged


def _pictures(data: DataSet, size: tuple[int, int]) -> tuple[Any, list[dict[str, Any]]]:
    """Returns the column of pictures, as PNG, and the statistics of each episode's colours."""
    width, height = size
    column, statistics = [], []
    for motion in data.motions:
        colours = []
        for picture in frames(data.mjcf, motion.states[:-1], height, width):
            file = io.BytesIO()
            Image.fromarray(picture).save(file, "PNG")
            column.append({"bytes": file.getvalue(), "path": None})
            colours.append(picture[::8, ::8].reshape(-1, 3) / 255.0)
        found = _statistics(np.concatenate(colours))
        # LeRobot's pictures have their three colours first.
        shaped = {k: [[[c]] for c in v] for k, v in found.items() if k != "count"}
        statistics.append(shaped | {"count": [len(motion.states) - 1]})
    kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    return pa.array(column, kind), statistics


def _episodes(data: DataSet, statistics: list[dict[str, Any]], task: str) -> Any:
    ends = np.cumsum(data.lengths)
    count, zeros = len(data.motions), [0] * len(data.motions)
    columns: dict[str, Any] = {
        "episode_index": range(count),
        "tasks": [[task]] * count,
        "length": data.lengths,
        "data/chunk_index": zeros,
        "data/file_index": zeros,
        "dataset_from_index": (ends - data.lengths).tolist(),
        "dataset_to_index": ends.tolist(),
    }
    for name, kinds in statistics[0].items():
        columns |= {f"stats/{name}/{kind}": [s[name][kind] for s in statistics] for kind in kinds}
    columns |= {"meta/episodes/chunk_index": zeros, "meta/episodes/file_index": zeros}
    return pa.table({name: pa.array(list(values)) for name, values in columns.items()})


def _tasks(task: str) -> Any:
    """Returns the table of tasks as pandas writes one whose rows are named by their task."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {"name": n, "field_name": n, "pandas_type": p, "numpy_type": t, "metadata": None}
        for n, (p, t) in kinds.items()
    ]
    pandas = {"index_columns": ["task"], "columns": columns, "column_indexes": []}
    table = pa.table({"task_index": pa.array([0]), "task": pa.array([task])})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def _info(data: DataSet, rate: int, robot: str, size: tuple[int, int] | None) -> dict[str, Any]:
    def feature(kind: str, shape: list[int], names: list[str] | None) -> dict[str, Any]:
        return {"dtype": kind, "shape": shape, "names": names}

    features = {
        "observation.state": feature("float32", [len(data.state_names)], data.state_names),
        "action": feature("float32", [len(data.control_names)], data.control_names),
        "timestamp": feature("float32", [1], None),
        **{name: feature("int64", [1], None) for name in _COUNTS},
    }
    if size:
        width, height = size
        features[_PICTURE] = feature("image", [height, width, 3], ["height", "width", "channels"])
    return {
        "codebase_version": "v3.0",
        "robot_type": robot,
        "total_episodes": len(data.motions),
        "total_frames": sum(data.lengths),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate,
        "splits": {"train": f"0:{len(data.motions)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }


def _write(path: Path, table: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pa.parquet.write_table(table, path)
