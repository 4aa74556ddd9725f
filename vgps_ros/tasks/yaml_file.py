# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads a YAML file as a record, with the line of each entry, so that errors can name it.

The file may come from anybody, so only the plain part of YAML is read: mappings, lists, texts and
numbers. Tags, anchors, aliases and further documents are refused, and nothing is ever executed.
Numbers are those of YAML 1.2, in which `1e-4` is a number and `yes` is a text. A key without a
value counts as left out.
"""

import os
import re
import types
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import islice
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec
import yaml
from msgspec import Meta
from msgspec.structs import fields

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
        where = f", {place_in_words(place)}" if place else ""
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


def place_in_words(place: Place) -> str:
    """Returns a place as an error names it: `cost[0].sensor`."""
    text = ""
    for key in place:
        if isinstance(key, int):
            text += f"[{key}]"
        else:
            text += f".{key}" if len(key) <= 60 else f".{quoted(key)}"
    return text.removeprefix(".")


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


R = TypeVar("R", bound=msgspec.Struct)
_NAMES = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
_BOUNDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
_HUGE = 1e9


def as_record(document: Document, kind: type[R]) -> R:
    """Returns a document's data as a record.

    Raises:
        InvalidInputError: an entry does not fit; the sentence says which, and what would fit.
    """
    try:
        return msgspec.convert(document.data, kind)
    except msgspec.ValidationError as error:
        place, sentence = _misfit(document.data, kind, (), "")
        raise document.error(place, sentence) from error


def _misfit(value: Any, kind: Any, place: Place, hint: str) -> tuple[Place, str]:
    """Returns the innermost entry that does not fit, and a sentence about it.

    Args:
        value: what does not fit.
        kind: the type that it should have.
        place: its place.
        hint: description and example of the field around it.
    """
    for key, child, child_kind in _children(value, kind):
        if not _fits(child, child_kind):
            return _misfit(child, child_kind, (*place, key), _hint(str(key), child_kind) or hint)
    records = [member for member in _members(kind) if _is_record(member)]
    if not (isinstance(value, dict) and records):
        choices = [str(each) for member in _members(kind) for each in _choices(member)]
        return place, (
            f"it is {_named(value)}, but it must be {_wanted(kind, value)}{hint}."
            f"{nearest(str(value), choices)}"
        )
    record = _member_for(value, kind)
    if record is None:
        config = records[0].__struct_config__
        laws = [member.__struct_config__.tag for member in records]
        word = value.get(config.tag_field, "")
        return (*place, config.tag_field), (
            f"it is {_named(word)}, but it must be one of {', '.join(laws)}{hint}."
            f"{nearest(str(word), laws)}"
        )
    return _wrong_key(value, record, place)


def _wrong_key(value: dict[str, Any], record: Any, place: Place) -> tuple[Place, str]:
    """Returns the place of a key that its record lacks, or of a mapping that lacks a key."""
    known = {field.encode_name: field for field in fields(record)}
    tag = record.__struct_config__.tag_field
    names = [*([tag] if tag else []), *known]
    for key in value:
        if key not in names:
            return (*place, key), (
                f"{quoted(key)} is no key here; the keys are {', '.join(names)}."
                f"{nearest(key, names)}"
            )
    missing = next(name for name in known if known[name].required and name not in value)
    return place, f"the key {quoted(missing)} is missing{_hint(missing, known[missing].type)}."


def _children(value: Any, kind: Any) -> Iterator[tuple[str | int, Any, Any]]:
    """Yields key, value and type of each entry that a value holds."""
    member = _member_for(value, kind)
    if member is None:
        return
    if _is_record(member):
        known = {field.encode_name: field.type for field in fields(member)}
        yield from ((key, value[key], known[key]) for key in value if key in known)
    elif isinstance(value, dict):
        yield from ((key, value[key], get_args(member)[1]) for key in value)
    else:
        first, *others = get_args(member)
        kinds = [first] * len(value) if others[-1:] == [...] else [first, *others]
        yield from ((i, *pair) for i, pair in enumerate(zip(value, kinds, strict=False)))


def _fits(value: Any, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _members(kind: Any) -> list[Any]:
    """Returns the types of a union, or the type alone, without their annotations."""
    while get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    if get_origin(kind) in (Union, types.UnionType):
        return [member for each in get_args(kind) for member in _members(each)]
    return [kind]


def _member_for(value: Any, kind: Any) -> Any:
    """Returns the member of a union that takes a mapping or a list; None if there is none."""
    for member in _members(kind):
        if isinstance(value, dict) and _is_record(member):
            config = member.__struct_config__
            if config.tag is None or value.get(config.tag_field) == config.tag:
                return member
        if isinstance(value, {dict: dict, tuple: list}.get(get_origin(member), ())):
            return member
    return None


def _named(value: Any) -> str:
    """Returns a value as a sentence names it."""
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "empty"}[value]
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return "a mapping" if isinstance(value, dict) else quoted(value)


def _choices(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if get_origin(kind) is Literal else ()


def _wanted(kind: Any, value: Any) -> str:
    """Returns the values of a type in words: `a number above 0`."""
    if get_origin(kind) is Annotated:
        inner, *metas = get_args(kind)
        return _wanted(inner, value) + "".join(_range(meta, value) for meta in metas)
    if get_origin(kind) in (Union, types.UnionType):
        kinds = [each for each in get_args(kind) if each is not types.NoneType]
        return " or ".join(dict.fromkeys(_wanted(each, value) for each in kinds))
    if _choices(kind):
        return f"one of {', '.join(map(str, _choices(kind)))}"
    if get_origin(kind) is tuple:
        return "a list" if ... in get_args(kind) else f"a list of {len(get_args(kind))}"
    return _NAMES.get(kind, "a mapping")


def _range(meta: Meta, value: Any) -> str:
    """Returns the range that an annotation allows; a huge bound matters to a number only."""
    bounds = {word: getattr(meta, name) for name, word in _BOUNDS.items()}
    known = {word: bound for word, bound in bounds.items() if bound is not None}
    matter = isinstance(value, float | int)
    found = [f"{word} {at:g}" for word, at in known.items() if matter or abs(at) < _HUGE]
    if meta.max_length is not None:
        found.append(f"of length {meta.min_length or 0} to {meta.max_length}")
    elif meta.min_length is not None:
        found.append("that is not empty")
    return f" {' and '.join(found)}" if found else ""


def _hint(name: str, kind: Any) -> str:
    """Returns a field's description and example as the end of a sentence; empty without them."""
    metas = get_args(kind)[1:] if get_origin(kind) is Annotated else ()
    description = next((meta.description for meta in metas if meta.description), "")
    example = next((meta.examples[0] for meta in metas if meta.examples), None)
    if not description:
        return ""
    text = yaml.safe_dump({name: example}, default_flow_style=True, sort_keys=False, width=1000)
    return f": {description}; for example `{text.strip()[1:-1]}`"
