# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Arrays that are fields of records: each is declared once, with its shape.

A field such as `gains: Annotated[Array, Shape("T", "n_u", "n_x")]` names its sizes by symbols.
Files, messages and checks ask here which arrays a record has and which shape each must have. The
name of an array in a nested record is dotted, as in "mean.states".
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Record = TypeVar("Record")


class Shape:
    """Declares the shape of a field that is an array.

    Args:
        sizes: a symbol for each axis; "T+1" is one more than "T".
        is_covariance: whether the matrices must be symmetric and positive semidefinite.
    """

    def __init__(self, *sizes: str, is_covariance: bool = False):
        self.sizes = sizes
        self.is_covariance = is_covariance

    def of(self, values: Mapping[str, int]) -> tuple[int, ...]:
        """Returns the shape as numbers, where the symbols have these values."""
        return tuple(values[size.removesuffix("+1")] + size.endswith("+1") for size in self.sizes)


def declared_shapes(kind: Any) -> dict[str, Shape]:
    """Returns the declarations of a record type's arrays by name, nested records included."""
    found: dict[str, Shape] = {}
    for f in fields(kind):
        if is_dataclass(f.type):
            found |= {f"{f.name}.{name}": shape for name, shape in declared_shapes(f.type).items()}
        for note in getattr(f.type, "__metadata__", ()):
            found[f.name] = note
    return found


def array_shapes(kind: Any, **values: int) -> dict[str, tuple[int, ...]]:
    """Returns the shapes of a record type's arrays by name, for these values of the symbols."""
    return {name: shape.of(values) for name, shape in declared_shapes(kind).items()}


def arrays_of(record: Any) -> dict[str, Array]:
    """Returns a record's arrays by name."""
    return {name: attrgetter(name)(record) for name in declared_shapes(type(record))}


def from_arrays(kind: type[Record], arrays: Mapping[str, Array]) -> Record:
    """Returns a record, all of whose fields are arrays or such records, from arrays by name."""
    values: dict[str, Any] = {}
    for f in fields(kind):  # type: ignore[arg-type]
        if is_dataclass(f.type):
            inner = {
                n.partition(".")[2]: a for n, a in arrays.items() if n.startswith(f"{f.name}.")
            }
            values[f.name] = from_arrays(f.type, inner)  # type: ignore[arg-type]
        else:
            values[f.name] = arrays[f.name]
    return kind(**values)


def first_steps(record: Record, steps: int) -> Record:
    """Returns a record whose arrays run over T or T+1 steps first, cut to T = `steps`."""
    declared = declared_shapes(type(record))
    cut = {n: a[: steps + declared[n].sizes[0].count("+1")] for n, a in arrays_of(record).items()}
    return from_arrays(type(record), cut)
