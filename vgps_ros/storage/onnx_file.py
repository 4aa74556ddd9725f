# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads ONNX files of strangers: nothing outside the file is opened, and no graph runs for ever.

It needs the package `onnx`, which requirements/onnx.txt pins. It is imported when a file is read
or written, so that nothing else waits for it.
"""

import importlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vgps_ros.core.checks import finite_array, quoted
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.records import Array

NO_TELEMETRY = "ORT_DISABLE_TELEMETRY"
LARGEST = 64 << 20  # [bytes]; policies of legged robots take about 1 MB
_MOST_NODES = 10_000
DOMAINS = ("", "ai.onnx")


def package(name: str) -> Any:
    """Returns a module of the packages onnx or onnxruntime.

    From 1.29 on onnxruntime tells its maker the names of networks and files, unless it is told not
    to before it is imported.

    Raises:
        VgpsError: it is not installed.
    """
    os.environ.setdefault(NO_TELEMETRY, "1")
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise VgpsError(
            f"An ONNX policy needs the package {name.partition('.')[0]}: pip install -r "
            "requirements/onnx.txt."
        ) from error


def read_bytes(path: Path) -> bytes:
    """Returns the content of an ONNX file.

    Raises:
        InvalidInputError: it is missing, no plain file, or too large for a policy.
    """
    try:
        if not path.is_file():
            raise InvalidInputError(f"'{path}' is no file; name the ONNX file of a policy.")
        size = path.stat().st_size
        if size > LARGEST:
            raise InvalidInputError(
                f"'{path}' has {size / 1e6:.0f} MB, but the ONNX file of a policy may have at most "
                f"{LARGEST / 1e6:.0f} MB: use a smaller network."
            )
        with path.open("rb") as file:
            return file.read(LARGEST)
    except OSError as error:
        raise InvalidInputError(f"'{path}' cannot be read: {error.strerror}.") from error


def parsed(content: bytes, name: str) -> Any:
    """Returns the model in the bytes of an ONNX file, after it was found to be harmless.

    Args:
        content: the bytes.
        name: what the sentence of an error calls the file.

    Raises:
        InvalidInputError: the bytes are no ONNX model; or it keeps tensors in other files, or holds
            loops, branches or functions, or operators that are not of ONNX.
    """
    onnx = package("onnx")
    if len(content) > LARGEST:
        raise InvalidInputError(
            f"{name} is larger than {LARGEST / 1e6:.0f} MB; use a smaller network."
        )
    try:
        model = onnx.load_model_from_string(content)
    except Exception as error:  # of protobuf, whose classes differ between its implementations
        raise InvalidInputError(
            f"{name} is not an ONNX model, or is damaged ({str(error).strip():.80}); export it "
            "anew."
        ) from error
    graph = model.graph
    if not (graph.node and graph.input and graph.output):
        raise InvalidInputError(
            f"{name} has no graph with nodes, inputs and outputs; export it anew."
        )
    if len(graph.node) > _MOST_NODES:
        raise InvalidInputError(
            f"{name} has {len(graph.node)} nodes, but a policy may have at most {_MOST_NODES}: "
            "use a smaller network."
        )
    if model.functions:
        raise InvalidInputError(f"{name} has local functions; export it with them inlined.")
    for node in graph.node:
        if node.domain not in DOMAINS:
            raise InvalidInputError(
                f"{name} has the operator {quoted(node.op_type)} of {quoted(node.domain)}, but a "
                "policy may use the operators of ONNX alone; export it with these."
            )
        if any(a.HasField("g") or a.graphs for a in node.attribute):
            raise InvalidInputError(
                f"{name} has a node {quoted(node.op_type)} with a graph of its own, but a policy "
                "must be without loops and branches; export it with them unrolled."
            )
    external = onnx.TensorProto.EXTERNAL
    for tensor in _tensors(graph):
        if tensor.data_location == external or tensor.external_data:
            raise InvalidInputError(
                f"{name} keeps the tensor {quoted(tensor.name)} in another file, which is not "
                "read; export it with all weights inside."
            )
    return model


def metadata_of(model: Any) -> dict[str, str]:
    """Returns the metadata of a model, by key, without those that are no text."""
    pairs = [(entry.key, entry.value) for entry in model.metadata_props]
    return {key: value for key, value in pairs if isinstance(key, str) and isinstance(value, str)}


def names_of(metadata: dict[str, str], key: str, name: str) -> tuple[str, ...]:
    """Returns names that are separated by commas.

    Raises:
        InvalidInputError: the key is missing.
    """
    words = tuple(word.strip() for word in metadata.get(key, "").split(",") if word.strip())
    if not words:
        raise InvalidInputError(
            f"{name} has no metadata {key!r}, so nothing tells what its numbers mean; add it, with "
            "the names separated by commas (docs/how_to/export.md)."
        )
    return words


def numbers_of(metadata: dict[str, str], key: str, default: float, count: int, name: str) -> Array:
    """Returns numbers that are separated by commas, shape (count,); one may stand for all.

    Raises:
        InvalidInputError: there are as many others, or one is no finite number.
    """
    words = metadata.get(key, str(default)).split(",")
    values = words * count if len(words) == 1 else words
    if len(values) != count:
        raise InvalidInputError(
            f"The metadata {key!r} of {name} has {len(values)} values, but 'joint_names' has "
            f"{count} joints; give a value for each of them, or one for all."
        )
    return finite_array(f"the metadata {key!r} of {name}", values, (count,))


def _tensors(graph: Any) -> Iterator[Any]:
    yield from graph.initializer
    for sparse in graph.sparse_initializer:
        yield from (sparse.values, sparse.indices)
    for node in graph.node:
        for attribute in node.attribute:
            yield from (attribute.t, *attribute.tensors)
            for sparse in (attribute.sparse_tensor, *attribute.sparse_tensors):
                yield from (sparse.values, sparse.indices)
