"""Archives of arrays (.npz), written in one piece; reading one can run no code."""

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.files import replacing

# NumPy's reader raises these of a file that is no archive, is damaged, or holds pickled objects.
_MALFORMED = (
    *(zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, MemoryError),
    *(KeyError, IndexError, AttributeError, TypeError, ValueError, SyntaxError),
)


def write_archive(path: Path, arrays: Mapping[str, NDArray]) -> None:
    """Writes arrays by name.

    Raises:
        OSError: the file cannot be written; an old one is still there.
    """
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
