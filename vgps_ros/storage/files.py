# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files that are written in one piece, and reading that can run no code, of untrusted files too.

A record becomes a tree of JSON values, in which a name stands for each array. Reading it back
follows the types that the records declare, so that a file can choose none but those.
"""

import base64
import errno
import json
import math
import os
import stat
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from io import BufferedReader, BytesIO
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, BinaryIO, NewType, get_args, get_origin, get_type_hints

import numpy as np
import yaml
from numpy.lib.format import read_array
from numpy.typing import NDArray

from vgps_ros.core.checks import one_of, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array

Text = NewType("Text", str)
"""The type of a field of a record that is a text of many lines; any other is a name."""

_LONGEST_NAME = 1000  # letters

_LARGEST_FILE = 2**28  # far more than a policy of 10,000 units or the results of a long run [bytes]

# NumPy's reader raises these of a file that is no archive, is damaged, or holds pickled objects.
_MALFORMED = (
    *(zipfile.BadZipFile, EOFError, RuntimeError, MemoryError),
    *(KeyError, IndexError, AttributeError, TypeError, ValueError, SyntaxError),
)


def part_of(path: Path) -> Path:
    """Returns the name under which a file stands until it is whole."""
    return path.with_name(path.name + ".part")


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Gives a file that takes the place of `path` at the end of the `with` statement.

    A reader, or whoever comes after a crash, finds the old file or the new one, never a part.

    Raises:
        OSError: it cannot be written; the old one is still there.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"There is no folder '{path.parent}'; make it, or name another.")
    part = part_of(path)
    try:
        with part.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the new name outlives a loss of power
    finally:
        os.close(folder)


def write_json(path: Path, content: Any) -> None:
    """Writes a JSON file in one piece: a reader sees the old one or the new one, never a part."""
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    with replacing(path) as file:
        file.write(text.encode())


def open_plain(path: Path) -> BufferedReader:
    """Opens a plain file to read it; a pipe would be waited for, and a device never ends.

    Raises:
        OSError: it is missing, or no plain file.
    """
    file = open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK))  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is no plain file", str(path))
    return file


def read_file(path: Path, largest: int = _LARGEST_FILE) -> bytes:
    """Returns the content of a plain file.

    Raises:
        OSError: it is missing, no plain file, or has more bytes than `largest`.
    """
    with open_plain(path) as file:
        if (size := os.fstat(file.fileno()).st_size) > largest:
            sizes = f"it has {size / 1e6:.0f} MB, and at most {largest / 1e6:.0f} MB are read"
            raise OSError(errno.EFBIG, sizes, str(path))
        return file.read(size)


def read_json(path: Path) -> Any:
    """Reads a JSON file.

    Raises:
        OSError: as of `read_file`.
        ValueError: it is no JSON, or is nested too deeply.
    """
    try:
        return json.loads(read_file(path))
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def write_archive(path: Path, arrays: Mapping[str, NDArray]) -> None:
    """Writes arrays by name as an archive (.npz), in one piece."""
    with replacing(path) as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def read_archive(path: Path) -> dict[str, NDArray]:
    """Reads all arrays of an archive that is not compressed, bit for bit.

    Raises:
        OSError: the file is missing or cannot be read.
        InvalidInputError: it is no archive, damaged, or holds objects, or more than its size.
    """
    try:
        with open_plain(path) as file, zipfile.ZipFile(file) as archive:
            size, unpacked = path.stat().st_size, sum(i.file_size for i in archive.infolist())
            if unpacked > size or any(i.compress_type for i in archive.infolist()):
                what = f"its {size} bytes would become {unpacked}, or are compressed"
                raise ValueError(f"{what}; save it uncompressed")
            members = {name: BytesIO(archive.read(name)) for name in archive.namelist()}
        return {name.removesuffix(".npy"): read_array(each) for name, each in members.items()}
    except _MALFORMED as error:
        raise InvalidInputError(f"'{path}' is no whole archive of arrays: {error}.") from error


_LARGEST = 2**21  # which takes some seconds [characters]
_MOST = 10**6  # values, where each alias counts as what it stands for
_DEEPEST = 100  # nesting


def read_yaml(text: str | bytes, what: str) -> Any:
    """Returns the content of a YAML text, which an error calls `what`.

    Raises:
        InvalidInputError: it is no YAML, or would become much larger than it is.
    """
    try:
        if len(text) > _LARGEST:
            raise ValueError(f"it has {len(text)} characters, and at most {_LARGEST} are read")
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        if _size(node, {}, _DEEPEST) > _MOST:
            raise ValueError(f"its aliases stand for more than {_MOST} values")
        return loader.construct_document(node)
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError, TypeError) as error:
        sentence = " ".join(str(error).split())
        raise InvalidInputError(f"{what} is no YAML that can be read: {sentence:.200}.") from error


def as_json(value: Any) -> Any:
    """Returns what `read_yaml` gave with nothing that JSON lacks: what it lacks becomes a text."""
    if isinstance(value, dict):
        return {one if isinstance(one, str) else str(one): as_json(v) for one, v in value.items()}
    if isinstance(value, list | tuple | set):
        return [as_json(one) for one in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    is_plain = value is None or isinstance(value, str | int)
    is_plain |= isinstance(value, float) and math.isfinite(value)
    return value if is_plain else str(value)


def _size(node: yaml.Node, known: dict[int, int], depth: int) -> int:
    """Counts the values of a node, where those that it shares count each time."""
    if not depth:
        raise ValueError("it is nested too deeply, or holds itself")
    if id(node) not in known:
        parts = node.value if isinstance(node, yaml.CollectionNode) else []
        inner = [one for part in parts for one in (part if isinstance(part, tuple) else (part,))]
        known[id(node)] = 1 + sum(_size(one, known, depth - 1) for one in inner)
    return known[id(node)]


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
            type, arrays of floats, enumerations, names, `Text` or numbers.
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
        return tuple(from_tree(element, entry, arrays) for entry in _check_kind(tree, list))
    if origin is np.ndarray:
        array = arrays.get(_check_kind(tree, str))
        if array is None or array.dtype != np.float64:
            raise InvalidInputError(f"{quote(tree)} must name an array of 64-bit floats.")
        return array
    if kind is Text:
        return _check_kind(tree, str)
    if issubclass(kind, Enum):
        values = [each.value for each in kind]
        return kind(one_of(f"A {kind.__name__}", _check_kind(tree, str), values))
    if kind is str and not (_check_kind(tree, str).isprintable() and len(tree) <= _LONGEST_NAME):
        raise InvalidInputError(f"{quote(tree)} is no name: one prints on a line.")
    if kind is float and type(tree) is int:  # a setting that was given as a whole number
        return tree
    return _check_kind(tree, kind)


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
    entries = dict(_check_kind(tree, dict))
    name = entries.pop(_RECORD, None)
    (chosen,) = [choice for choice in choices if choice.__name__ == name] or (None,)
    if chosen is None or set(entries) != {f.name for f in fields(chosen)}:
        wanted = " or ".join(choice.__name__ for choice in choices)
        raise InvalidInputError(f"A record {quote(name)} stands where a whole {wanted} must be.")
    return from_entries(chosen, entries, arrays)


def _check_kind(tree: Any, kind: type) -> Any:
    if type(tree) is not kind:
        raise InvalidInputError(f"{tree!r:.40} stands where a {kind.__name__} must be.")
    return tree
