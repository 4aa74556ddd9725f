# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files that are written in one piece; reading one can run no code."""

import json
import os
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.errors import InvalidInputError

_LARGEST_JSON = 2**28  # far more than a policy of 10,000 units or the results of a long run [bytes]

# NumPy's reader raises these of a file that is no archive, is damaged, or holds pickled objects.
_MALFORMED = (
    *(zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, MemoryError),
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
    _sync(path.parent)


def write_json(path: Path, content: Any) -> None:
    """Writes a JSON file in one piece: a reader sees the old one or the new one, never a part."""
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    with replacing(path) as file:
        file.write(text.encode())


def read_json(path: Path) -> Any:
    """Reads a JSON file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no JSON, no plain file, or is too large or nested too deeply.
    """
    size = path.stat().st_size
    if not path.is_file():  # a named pipe would be waited for
        raise ValueError("it is no plain file")
    if size > _LARGEST_JSON:
        raise ValueError(
            f"it has {size / 1e6:.0f} MB, but at most {_LARGEST_JSON / 1e6:.0f} MB are read"
        )
    try:
        return json.loads(path.read_bytes())
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def write_archive(path: Path, arrays: Mapping[str, NDArray]) -> None:
    """Writes arrays by name as an archive (.npz), in one piece."""
    with replacing(path) as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def read_archive(path: Path) -> dict[str, NDArray]:
    """Reads all arrays of an archive, bit for bit.

    Raises:
        OSError: the file is missing or cannot be read.
        InvalidInputError: the file is no archive, is damaged, or holds objects of Python.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
        if damaged:
            raise InvalidInputError(f"the check sum of {damaged} is wrong")
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except _MALFORMED as error:
        raise InvalidInputError(f"'{path}' is no whole archive of arrays: {error}.") from error


def _sync(folder: Path) -> None:
    """Takes care that a file's new name outlives a loss of power."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
