# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Records as JSON values and arrays, and back: for files that can run no code.

A record becomes a tree of JSON values, in which a name stands for each array. Reading it back
follows the types that the records declare, so that a file can choose none but those.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array

_RECORD = "record"  # key of a record's name


def to_tree(value: Any, arrays: dict[str, Array]) -> Any:
    """Returns a frozen record as JSON values; its arrays are put into `arrays`, by name.

    Raises:
        TypeError: a value is neither a record, a tuple, an array, text nor a Python number.
    """
    if isinstance(value, np.ndarray):
        name = f"array_{len(arrays)}"
        arrays[name] = value
        return name
    if is_dataclass(value):
        entries = {f.name: to_tree(getattr(value, f.name), arrays) for f in fields(value)}
        return {_RECORD: type(value).__name__, **entries}
    if isinstance(value, tuple):
        return [to_tree(entry, arrays) for entry in value]
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"A {type(value).__name__} cannot be written to a tree of records.")


def from_tree(kind: Any, tree: Any, arrays: Mapping[str, Array]) -> Any:
    """Returns what `to_tree` wrote.

    Args:
        kind: its type: a record whose fields are records, unions of records and None, tuples of one
            type, arrays of floats, enumerations, text or numbers.
        tree: the JSON values.
        arrays: by name.

    Raises:
        InvalidInputError: the tree is not of this type, or a record refuses its values.
    """
    origin = get_origin(kind)
    if isinstance(kind, UnionType) or is_dataclass(kind):
        return _record(kind, tree, arrays)
    if origin is tuple:
        element = get_args(kind)[0]
        return tuple(from_tree(element, entry, arrays) for entry in _expected(tree, list))
    if origin is np.ndarray:
        array = arrays.get(_expected(tree, str))
        if array is None or array.dtype != np.float64:
            raise InvalidInputError(f"{tree} must be the name of an array of 64-bit floats.")
        return array
    if issubclass(kind, Enum):
        return kind(tree)
    if kind is float and type(tree) is int:  # a setting that was given as a whole number
        return tree
    return _expected(tree, kind)


def from_entries(kind: Any, entries: Any, arrays: Mapping[str, Array], **narrower: Any) -> Any:
    """Returns a record from the trees of its fields by name, as `from_tree` does.

    Where the type of a field is known better than the record declares, it is given by name.

    Raises:
        KeyError: a field is missing.
        InvalidInputError: a tree is not of its field's type, or the record refuses its values.
    """
    types = get_type_hints(kind) | narrower
    return kind(**{f.name: from_tree(types[f.name], entries[f.name], arrays) for f in fields(kind)})


def _record(kind: Any, tree: Any, arrays: Mapping[str, Array]) -> Any:
    choices = get_args(kind) or (kind,)
    if tree is None and NoneType in choices:
        return None
    entries = dict(_expected(tree, dict))
    name = entries.pop(_RECORD, None)
    (chosen,) = [choice for choice in choices if choice.__name__ == name] or (None,)
    if chosen is None or set(entries) != {f.name for f in fields(chosen)}:
        wanted = " or ".join(choice.__name__ for choice in choices)
        raise InvalidInputError(f"A record {name!r} stands where a whole {wanted} must be.")
    return from_entries(chosen, entries, arrays)


def _expected(tree: Any, kind: type) -> Any:
    if type(tree) is not kind:
        raise InvalidInputError(f"{tree!r:.40} stands where a {kind.__name__} must be.")
    return tree
