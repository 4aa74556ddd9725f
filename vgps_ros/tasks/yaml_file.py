# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads a YAML file as a record, with the line of each entry, so that errors can name it.

ruamel.yaml parses the text and knows the lines, msgspec judges the values, and the JSON schema of
the record says what would be right. The file may be untrusted: no objects are made, and anchors
and aliases are refused. Numbers are those of YAML 1.2, in which `1e-4` is a number and `yes` is a
text. A key without a value counts as left out.
"""

import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from ruamel.yaml import YAML, MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.parser import ParserError
from ruamel.yaml.scanner import ScannerError

from vgps_ros.core.checks import nearest, quoted
from vgps_ros.core.errors import InvalidInputError

Place = tuple[str | int, ...]  # keys and positions that lead to an entry
R = TypeVar("R", bound=msgspec.Struct)

LARGEST_FILE = 1_000_000  # [bytes]
_LONGEST_ERROR = 480
_WORDS = {  # msgspec's words, and plain ones
    " | null": "",
    "null | ": "",
    " | ": " or ",
    "`": "",
    "float": "a number",
    "int": "a whole number",
    "str": "a text",
    "bool": "true or false",
    "object": "a mapping",
    "array": "a list",
    " >= ": " of at least ",
    " > ": " above ",
    " <= ": " of at most ",
    " < ": " below ",
    "length of at": "length at",
}


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


def read_document(path: Path) -> Document:
    """Reads a YAML file whose top level is a mapping.

    Raises:
        InvalidInputError: the file cannot be read, or is no plain YAML.
    """
    document = Document(path, {}, {(): 1})
    text = _text(document)
    try:
        node = YAML(typ="safe", pure=True).compose(text)
        if node is None:
            raise document.error((), "the file is empty; it must begin with a key.")
        if not isinstance(node, MappingNode):
            sentence = "the file must hold keys with values, such as `horizon: 4.0`."
            raise document.error((), sentence)
        _note_lines(document, node, ())
        document.data.update(_given(YAML(typ="safe", pure=True).load(text)))
    except InvalidInputError:
        raise
    except MarkedYAMLError as error:
        mark, hint = error.problem_mark or error.context_mark, ""
        if isinstance(error, ScannerError | ParserError):
            hint = "; check the indentation, the brackets, and the colon and space behind each key"
        sentence = f"this is no plain YAML, {error.problem or error.context}{hint}."
        raise document.error_at(mark.line + 1 if mark else 1, sentence) from error
    except RecursionError as error:
        raise document.error((), "the values are nested too deeply.") from error
    except (YAMLError, ValueError, OverflowError, TypeError) as error:
        raise document.error((), f"this is no plain YAML: {error}.") from error
    return document


def _text(document: Document) -> str:
    """Returns the file's text."""
    path = document.path
    try:
        if not path.is_file():
            raise InvalidInputError(f"There is no file {quoted(str(path))}; name a YAML file.")
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"The file {shown(path)} cannot be read: {error}.") from error
    if len(data) > LARGEST_FILE:
        raise document.error((), f"the file is larger than {LARGEST_FILE} bytes; make it shorter.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise document.error_at(
            line, "the text is not in UTF-8; save the file as UTF-8."
        ) from error


def _note_lines(document: Document, node: Node, place: Place) -> None:
    """Notes the line of each entry, and refuses anchors and texts that do not print."""
    document.lines[place] = node.start_mark.line + 1 if place else 1
    if node.anchor:
        raise document.error(place, "anchors (&) are not read; write the value out.")
    if isinstance(node, ScalarNode) and not node.value.isprintable():
        raise document.error(
            place, f"the text {quoted(node.value)} must stand on one line, in letters that print."
        )
    if isinstance(node, SequenceNode):
        for i, entry in enumerate(node.value):
            _note_lines(document, entry, (*place, i))
    elif isinstance(node, MappingNode):
        for key, entry in node.value:
            if not isinstance(key, ScalarNode) or key.anchor or not key.value.isprintable():
                raise document.error_at(
                    key.start_mark.line + 1, "a key must be a plain text, such as `horizon: 4.0`."
                )
            here, line = (*place, key.value), key.start_mark.line + 1
            if here in document.lines:
                sentence = f"the key stands twice, here and in line {line}; leave one of them out."
                raise document.error(here, sentence)
            _note_lines(document, entry, here)
            document.lines[here] = line


def _given(value: Any) -> Any:
    """Returns a value without the keys that have no value."""
    if isinstance(value, dict):
        return {str(key): _given(entry) for key, entry in value.items() if entry is not None}
    return [_given(entry) for entry in value] if isinstance(value, list) else value


def as_record(document: Document, kind: type[R]) -> R:
    """Returns a document's data as a record.

    Raises:
        InvalidInputError: an entry does not fit; the sentence says which, and what would fit.
    """
    try:
        return msgspec.convert(document.data, kind)
    except msgspec.ValidationError as error:
        raise document.error(*_explained(document.data, kind, str(error))) from error


def _explained(data: Any, kind: type[R], error: str) -> tuple[Place, str]:
    """Returns the place of the entry that msgspec complains about, and a sentence on it."""
    complaint, _, path = error.partition(" - at `$")
    place, value = _entry(data, kind, path.rstrip("`"), error)
    schemas, hint = _schemas(kind, data, place)
    known = list(dict.fromkeys(key for each in schemas for key in each.get("properties", {})))
    if found := re.fullmatch("Object contains unknown field `(.*)`", complaint, re.S):
        return (*place, found[1]), (
            f"{quoted(found[1])} is no key here; the keys are {', '.join(known)}."
            f"{nearest(found[1], known)}"
        )
    if found := re.fullmatch("Object missing required field `(.*)`", complaint, re.S):
        _, hint = _schemas(kind, data, (*place, found[1]))
        return place, f"the key {quoted(found[1])} is missing{hint}."
    choices = list(dict.fromkeys(str(each) for one in schemas for each in one.get("enum", ())))
    wanted = f"one of {', '.join(choices)}"
    if not complaint.startswith("Invalid"):
        wanted = complaint.removeprefix("Expected ").partition(", got ")[0].strip("`")
        for word, plain in _WORDS.items():
            wanted = wanted.replace(word, plain)
        wanted = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):g}", wanted)
    return place, (
        f"it is {_named(value)}, but it must be {wanted}{hint}.{nearest(str(value), choices)}"
    )


def _entry(data: Any, kind: type[R], path: str, error: str) -> tuple[Place, Any]:
    """Returns the place and the value of an entry of which msgspec has the path, as `.cost[0]`."""
    place: Place = ()
    value = data
    for name, number in re.findall(r"\.([^.\[]+)|\[(\d+|\.\.\.)\]", path):
        if number == "...":  # some key of a mapping: the first that has the error by itself
            keys = [one for one in value if _complaint(data, kind, place, one) == error]
            key = (keys or list(value))[0]
        else:
            key = name or int(number)
        place, value = (*place, key), value[key]
    return place, value


def _complaint(data: Any, kind: type[R], place: Place, key: str) -> str:
    """Returns what msgspec says of the data if the mapping at a place has only this key."""
    data = inner = deepcopy(data)
    for each in place:
        inner = inner[each]
    for other in set(inner) - {key}:
        del inner[other]
    try:
        msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        return str(error)
    return ""


def _schemas(kind: type[R], data: Any, place: Place) -> tuple[list[dict[str, Any]], str]:
    """Returns the JSON schemas that an entry may fit, and the hint of the field around it."""
    root: dict[str, Any] = _schema_of(kind)
    schemas, hint = _alternatives(root, root, data), ""
    for key in place:
        data = data.get(key) if isinstance(data, dict) else data[key]
        inner = [found for each in schemas if (found := _part(each, key)) is not None]
        hint = next((_hint(key, each) for each in inner if "description" in each), hint)
        schemas = [one for each in inner for one in _alternatives(root, each, data)]
    return schemas, hint


@lru_cache
def _schema_of(kind: type[R]) -> dict[str, Any]:
    return msgspec.json.schema(kind)


def _alternatives(root: Any, schema: Any, value: Any) -> list[dict[str, Any]]:
    """Returns the schemas of a union, or those that a record's tag picks."""
    if "discriminator" in schema and isinstance(value, dict):
        choice = schema["discriminator"]
        tag = value.get(choice["propertyName"])
        if isinstance(tag, str) and tag in choice["mapping"]:
            schema = {"$ref": choice["mapping"][tag]}
    if "$ref" in schema:
        return _alternatives(root, root["$defs"][schema["$ref"].rpartition("/")[2]], value)
    if "anyOf" in schema:
        return [one for each in schema["anyOf"] for one in _alternatives(root, each, value)]
    return [schema]


def _part(schema: dict[str, Any], key: str | int) -> Any:
    """Returns the schema of an entry of a mapping or list; None if there is none."""
    if isinstance(key, int):
        return [*schema.get("prefixItems", ()), *[schema.get("items") or None] * (key + 1)][key]
    return schema.get("properties", {}).get(key, schema.get("additionalProperties") or None)


def _hint(key: str | int, schema: dict[str, Any]) -> str:
    """Returns a field's description and example as the end of a sentence."""
    example = json.dumps(schema["examples"][0], ensure_ascii=False) if "examples" in schema else ""
    return f": {schema['description']}" + (f"; for example `{key}: {example}`" if example else "")


def _named(value: Any) -> str:
    """Returns a value as a sentence names it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return "a mapping" if isinstance(value, dict) else quoted(value)
