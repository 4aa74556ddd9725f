# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A file's data, with the line of each entry, so that errors can name it."""

import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from vgps_ros.core.checks import nearest, quoted
from vgps_ros.core.errors import InvalidInputError

Place = tuple[str | int, ...]  # keys and positions that lead to an entry

_LONGEST_ERROR = 480


@dataclass(frozen=True)
class Document:
    """The data of a file.

    Attributes:
        path: the file.
        data: its top level.
        lines: the line of each entry, such as ("cost", 0, "sensor"); () is the whole file.
    """

    path: Path
    data: dict[str, Any]
    lines: dict[Place, int]

    def error(self, place: Place, sentence: str) -> InvalidInputError:
        """Returns an error that begins with file, line and key of an entry.

        Args:
            place: the entry; for one that the file leaves out, the line is that of its parent.
            sentence: what is wrong and what would be right, with its full stop.
        """
        known = next(place[:n] for n in range(len(place), -1, -1) if place[:n] in self.lines)
        where = f", {in_words(place)}" if place else ""
        return self.error_at(self.lines[known], sentence, where)

    def refuse(self, wrong: bool, place: Place, sentence: str) -> None:
        """Raises such an error if something is wrong."""
        if wrong:
            raise self.error(place, sentence)

    def error_at(self, line: int, sentence: str, where: str = "") -> InvalidInputError:
        """Returns an error that begins with the file and a line of it."""
        text = f"{self.name} line {line}{where}: {sentence}"
        return InvalidInputError(shortened(text))

    @contextmanager
    def at(self, place: Place) -> Iterator[None]:
        """Lets the errors of a block begin with file, line and key of an entry."""
        try:
            yield
        except InvalidInputError as error:
            raise self.error(place, str(error)) from error

    def setting(self, place: Place, name: str) -> Place:
        """Returns the place of a setting by its dotted name, which may stand there nested."""
        return (*place, name) if (*place, name) in self.lines else (*place, *name.split("."))

    def file(self, place: Place, name: str) -> Path:
        """Returns the path of a file that an entry names, which must lie in the document's folder.

        Raises:
            InvalidInputError: the file lies elsewhere, or there is none.
        """
        folder = self.path.parent.resolve()
        path = self.existing(place, folder, name).resolve()
        if not path.is_relative_to(folder):
            raise self.error(
                place, f"the file {quoted(name)} lies outside this file's folder; move it there."
            )
        return path

    def existing(self, place: Place, folder: Path, name: str) -> Path:
        """Returns the path of a file that an entry names, from a folder.

        Raises:
            InvalidInputError: there is no such file.
        """
        try:
            path = folder / name
            if path.is_file():
                return path
            others = [entry.name for entry in islice(os.scandir(folder), 1000)]
        except (OSError, RuntimeError) as error:  # a name that is too long, a loop of links
            raise self.error(place, f"the file {quoted(name)} cannot be found.") from error
        raise self.error(
            place, f"there is no file {quoted(name)} in {shown(folder)}.{nearest(name, others)}"
        )

    @property
    def name(self) -> str:
        """The file as errors call it, with its folder, such as `hopper/task.yaml`."""
        return shown(self.path)


class Entries(dict[str, Any]):
    """Values of settings by dotted name, whose errors name the line that they have in a file.

    Args:
        values: the values.
        document: the file.
        place: the entry that they stand under.
    """

    def __init__(self, values: Mapping[str, Any], document: Document, *place: str):
        super().__init__(values)
        self._document, self._place = document, place

    def at(self, name: str) -> AbstractContextManager[None]:
        """Returns where errors name the line of a value, or that of all where it has no name."""
        place = self._document.setting(self._place, name) if name else self._place
        return self._document.at(place)


def shown(path: Path) -> str:
    """Returns a file's name with its folder, as a sentence can hold it."""
    name = "/".join(path.parts[-2:])
    return name if name.isprintable() and len(name) < 80 else quoted(name)


def shortened(sentence: str) -> str:
    """Returns a sentence on one line; the middle of one that is too long is left out."""
    text = "".join(letter if letter.isprintable() else " " for letter in sentence)
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST_ERROR else f"{text[:350]} ... {text[-100:]}"


def in_words(place: Place) -> str:
    """Returns a place as an error names it: `cost[0].sensor`."""
    text = ""
    for key in place:
        if isinstance(key, int):
            text += f"[{key}]"
        else:
            text += f".{key}" if len(key) <= 60 else f".{quoted(key)}"
    return text.removeprefix(".")
