# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads a YAML file as plain data.

The file may come from anybody, so only the plain part of YAML is read: mappings, lists, texts and
numbers. Tags, anchors, aliases and further documents are refused, and nothing is ever executed.
Numbers are those of YAML 1.2, in which `1e-4` is a number and `yes` is a text. A key without a
value counts as left out.
"""

import re
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import Any

import yaml

from vgps_ros.core.checks import quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks.document import Document, Place, shown

LARGEST_FILE = 1_000_000  # [bytes]
DEEPEST = 30  # levels of nesting
_LARGEST_INTEGER = 2**53  # above it, floats do not hold every integer

_NULL = {"", "~", "null", "Null", "NULL"}
_BOOLEANS = {
    word: word.lower() == "true" for word in ["true", "True", "TRUE", "false", "False", "FALSE"]
}
_INTEGER = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"([-+]?)\.(inf|Inf|INF)")


def read_document(path: Path) -> Document:
    """Reads a YAML file whose top level is a mapping.

    Raises:
        InvalidInputError: the file cannot be read, or is no plain YAML.
    """
    document = Document(path, {}, {(): 1})
    events = _events(document, _text(document))
    next(events)  # the stream begins
    if isinstance(next(events), yaml.StreamEndEvent):
        raise document.error_at(1, "the file is empty; it must begin with a key.")
    event = next(events)
    if not isinstance(event, yaml.MappingStartEvent | yaml.AliasEvent):
        raise document.error_at(
            _line(event), "the file must hold keys with values, such as `horizon: 4.0`."
        )
    document.data.update(_value(document, events, event, ()))
    next(events)  # the document ends
    event = next(events)
    if not isinstance(event, yaml.StreamEndEvent):
        raise document.error_at(
            _line(event), "a second document begins; leave only one, without ---."
        )
    return document


def _text(document: Document) -> str:
    """Returns the file's text."""
    path = document.path
    try:
        if not path.is_file():
            raise InvalidInputError(f"There is no file {quoted(str(path))}; name a YAML file.")
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise InvalidInputError(
            f"The file {shown(path)} cannot be read: {error.strerror}."
        ) from error
    if len(data) > LARGEST_FILE:
        raise document.error_at(
            1, f"the file is larger than {LARGEST_FILE} bytes; make it shorter."
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise document.error_at(
            line, "the text is not in UTF-8; save the file as UTF-8."
        ) from error


def _events(document: Document, text: str) -> Iterator[yaml.Event]:
    """Yields what the parser finds; its errors become sentences."""
    try:
        yield from yaml.parse(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise document.error_at(
            mark.line + 1 if mark else 1,
            f"this is no valid YAML, {error.problem or error.context}; check the indentation, the "
            "brackets, and the colon and space behind each key.",
        ) from error
    except yaml.reader.ReaderError as error:
        raise document.error_at(
            text.count("\n", 0, error.position) + 1,
            f"the character {quoted(chr(error.character))} may not stand in YAML; remove it.",
        ) from error
    except (ValueError, OverflowError, RecursionError) as error:  # escapes beyond Unicode
        raise document.error_at(1, f"this is no valid YAML: {quoted(str(error))}.") from error


def _value(
    document: Document, events: Iterator[yaml.Event], event: yaml.Event, place: Place
) -> Any:
    """Returns the value that an event begins."""
    line = _line(event)
    if len(place) > DEEPEST:
        raise document.error_at(line, f"values are nested deeper than {DEEPEST} levels.")
    if isinstance(event, yaml.AliasEvent) or event.anchor:
        raise document.error(
            place, "anchors (&) and aliases (*) are not read; write the value out."
        )
    if event.tag:
        raise document.error(
            place,
            f"the tag {quoted(event.tag)} is not read; leave it out, or put quotes around a text.",
        )
    if isinstance(event, yaml.ScalarEvent):
        return _scalar(document, event, place)
    if isinstance(event, yaml.SequenceStartEvent):
        items: list[Any] = []
        while not isinstance(event := next(events), yaml.SequenceEndEvent):
            here = (*place, len(items))
            document.lines[here] = _line(event)
            items.append(_value(document, events, event, here))
        return items
    entries: dict[str, Any] = {}
    while not isinstance(event := next(events), yaml.MappingEndEvent):
        if not isinstance(event, yaml.ScalarEvent) or event.anchor or event.tag:
            raise document.error_at(
                _line(event), "a key must be a plain text, such as `horizon: 4.0`."
            )
        here = (*place, _printable(document, event))
        if here in document.lines:
            raise document.error(
                here,
                f"the key stands twice, here and in line {_line(event)}; leave one of them out.",
            )
        document.lines[here] = _line(event)
        value = _value(document, events, next(events), here)
        if value is not None:
            entries[event.value] = value
    return entries


def _scalar(document: Document, event: yaml.ScalarEvent, place: Place) -> Any:
    """Returns the text, number, truth value or None of a scalar."""
    text = _printable(document, event)
    if event.style is not None:  # in quotes
        return text
    if text in _NULL:
        return None
    if text in _BOOLEANS:
        return _BOOLEANS[text]
    if text in {".nan", ".NaN", ".NAN"}:
        raise document.error(place, f"{text} is no value; write a number.")
    if found := _INFINITY.fullmatch(text):
        return float(f"{found[1]}inf")
    if not _NUMBER.fullmatch(text):
        return text
    number = int(text) if _INTEGER.fullmatch(text) and len(text) < 20 else float(text)
    if not isfinite(number) or (isinstance(number, int) and abs(number) > _LARGEST_INTEGER):
        raise document.error(place, f"the number {quoted(text)} is too large; write a smaller one.")
    return number


def _printable(document: Document, event: yaml.ScalarEvent) -> str:
    """Returns a scalar's text."""
    if not event.value.isprintable():
        raise document.error_at(
            _line(event),
            f"the text {quoted(event.value)} must stand on one line, in letters that print.",
        )
    return str(event.value)


def _line(event: yaml.Event) -> int:
    return int(event.start_mark.line) + 1
