"""Files that are written in one piece."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO


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


def _sync(folder: Path) -> None:
    """Takes care that a file's new name outlives a loss of power."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
