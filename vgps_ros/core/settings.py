# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings that carry their own description and range.

A setting is declared once, as a field of the record that uses it, with its type, range and unit:

    late: Annotated[float, Range(0.0, 1.0), "share of the samples that are read late"] = 0.0

The keys of a task file are declared alike (`vgps_ros.tasks.schema`). From this `--help` prints the
description and the range, a node declares its parameter, editors complete a task file, and values
are checked. A robot's computer has no msgspec, which reads task files, so the check is made here;
both say what would be right in a JSON schema, and `wrong_value` puts that into words.
"""

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from math import inf
from typing import Any, TypeVar, get_args

from vgps_ros.core.checks import nearest, one_of, quote
from vgps_ros.core.errors import InvalidInputError

Record = TypeVar("Record")

_LONGEST = 1000  # the most values that a setting may list
_KINDS: dict[Any, tuple[str, str]] = {  # types of values, in JSON schemas and in words
    bool: ("boolean", "true or false"),
    int: ("integer", "a whole number"),
    float: ("number", "a number"),
    str: ("string", "a text"),
    list: ("array", "a list"),
    dict: ("object", "a mapping"),
}


@dataclass(frozen=True)
class Range:
    """The smallest and the largest valid value; of a list, of each of its values."""

    low: float | None = None
    high: float | None = None


class Setting:
    """A setting, of a record or on its own.

    Attributes:
        name: its name; that of a setting in a nested record is dotted, as in `fit.late`.
        default: its default.
        description: a description of its effect, with its unit.
        is_list: whether it lists values, each of which must be valid.
        kind: the type of a value: bool, int, float or str.
        schema: the JSON schema of a value.
    """

    def __init__(self, name: str, default: Any, *notes: Any, kind: Any = None):
        """Makes a setting of a type, which is that of its default if none is named.

        Its range, if it has one, and its description follow, as in a record.
        """
        self.name, self.default, self.description = name, default, notes[-1]
        self.is_list = isinstance(default, tuple)
        if self.is_list:
            kind = get_args(kind)[0] if kind else type(default[0])
        kind = kind or type(default)
        choices = get_args(kind)
        self.kind = str if choices else kind
        limits = next((note for note in notes if isinstance(note, Range)), Range())
        found = {"minimum": limits.low, "maximum": limits.high, "enum": list(choices) or None}
        self.schema: dict[str, Any] = {
            "type": _KINDS[self.kind][0],
            **{key: limit for key, limit in found.items() if limit is not None},
        }

    def check(self, value: Any) -> None:
        """Checks a value.

        Raises:
            InvalidInputError: the value has another type, or is out of range.
        """
        if self.is_list and not isinstance(value, tuple):
            raise InvalidInputError(
                f"{self.name} is {quote(value)}, but it must be a list of values."
            )
        values = value if self.is_list else (value,)
        if len(values) > _LONGEST:
            raise InvalidInputError(
                f"{self.name} has {len(values)} values, but at most {_LONGEST} are taken."
            )
        if not values:
            raise InvalidInputError(f"{self.name} is empty, but it must have at least one value.")
        schema = self.schema
        low, high = schema.get("minimum", -inf), schema.get("maximum", inf)
        for each in values:
            is_right = _is_of(each, schema) and each in schema.get("enum", (each,))
            # Written so that NaN is refused.
            if not is_right or not (isinstance(each, str) or low <= each <= high):
                raise InvalidInputError(wrong_value(self.name, each, [schema]))

    def range(self) -> str:
        """Returns the valid range in words, nothing where every value of the type is valid."""
        return _range(self.schema)


def wrong_value(name: str, value: Any, schemas: Sequence[Mapping[str, Any]], hint: str = "") -> str:
    """Returns the sentence on a value that fits none of some JSON schemas.

    Args:
        name: what has the value.
        value: the value.
        schemas: what would be right; where one is for values of this type, by its range.
        hint: what follows, such as a description.
    """
    choices = [choice for schema in schemas for choice in schema.get("enum", ())]
    schemas = [s for s in schemas if "enum" not in s and s["type"] != "null"]
    if choices:
        schemas = [{"type": _type_of(choices[0]), "enum": choices}, *schemas]
    wanted = [_range(schema) for schema in schemas if _is_of(value, schema)]
    if not any(wanted):
        wanted = [_kind(schema) for schema in schemas]
        if len(schemas) == 1 and _range(schemas[0]) not in wanted:
            wanted = [f"{wanted[0]} {_range(schemas[0])}".strip()]
    shown = quote(value)
    if isinstance(value, bool):
        shown = shown.lower()
    elif isinstance(value, list | dict):
        shown = f"a list of {len(value)}" if isinstance(value, list) else "a mapping"
    return (
        f"{name} is {shown}, but it must be {' or '.join(dict.fromkeys(filter(None, wanted)))}"
        f"{hint}.{nearest(str(value), map(str, choices))}"
    )


def _type_of(value: Any) -> str:
    """Returns the name that JSON schemas have for the type of a value."""
    return next((name for kind, (name, _) in _KINDS.items() if isinstance(value, kind)), "")


def _is_of(value: Any, schema: Mapping[str, Any]) -> bool:
    """Returns whether a value has the type that a schema asks for; a whole number is a number."""
    kind = _type_of(value)
    return kind == schema["type"] or (kind, schema["type"]) == ("integer", "number")


def _kind(schema: Mapping[str, Any]) -> str:
    """Returns the type that a schema asks for, in words."""
    return _range(schema) if "enum" in schema else dict(_KINDS.values())[schema["type"]]


def _range(schema: Mapping[str, Any]) -> str:
    """Returns in words which values of its type a schema takes; nothing where it takes all."""
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}"
    least, low, high = (
        next((f"{schema[key]:g}" if isinstance(schema[key], float) else f"{schema[key]}"
              for key in keys if key in schema), "")
        for keys in (("exclusiveMinimum",), ("minimum", "minItems", "minLength"),
                     ("maximum", "maxItems", "maxLength"))
    )  # fmt: skip
    words = f"from {low} to {high}" if low and high else f"at least {low}" if low else ""
    if high and not low:
        words = f"at most {high}"
    if least:
        words = " and ".join(filter(None, (f"above {least}", words)))
    if words and schema["type"] in ("array", "string"):
        words = f"{_kind(schema)} of length {low if low == high else words}"
    return words


def settings_of(record: Any, prefix: str = "") -> Iterator[Setting]:
    """Yields the settings of a record, nested ones included, with its values as defaults."""
    for f in dataclasses.fields(record):
        value = getattr(record, f.name)
        if dataclasses.is_dataclass(value):
            yield from settings_of(value, f"{prefix}{f.name}.")
        else:
            form: Any = f.type
            yield Setting(prefix + f.name, value, *form.__metadata__, kind=form.__origin__)


def with_values(record: Record, values: Mapping[str, Any]) -> Record:
    """Returns the record with some settings replaced, all of them checked.

    Args:
        record: a settings record.
        values: new values by dotted name; other settings keep the record's value. Where they have
            a function `at`, errors of the value of a name are raised within `at(name)`, and those
            of all together within `at("")`.

    Raises:
        InvalidInputError: a name is unknown, or a value is of the wrong type or out of range.
    """
    known = {s.name: s for s in settings_of(record)}
    at = getattr(values, "at", lambda _: nullcontext())
    for name, value in values.items():
        with at(name):
            one_of("setting", name, known)
            known[name].check(value)
    with at(""):
        return _replace(record, values, "")


def check_settings(record: Any) -> None:
    """Checks every setting of a record.

    Raises:
        InvalidInputError: a value is of the wrong type or out of range.
    """
    for s in settings_of(record):
        s.check(s.default)


def values_of(*records: Any) -> dict[str, Any]:
    """Returns the values of settings records by dotted name, as JSON reads them back."""
    values = {s.name: s.default for record in records for s in settings_of(record)}
    return dict(json.loads(json.dumps(values)))


def differences(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> tuple[str, str]:
    """Returns both sides' values where they differ, in words; empty where they agree."""
    names = [name for name, value in ours.items() if theirs.get(name) != value]
    first, second = (
        ", ".join(f"{name} {values.get(name)}" for name in names) for values in (theirs, ours)
    )
    return first, second


def _replace(record: Any, values: Mapping[str, Any], prefix: str) -> Any:
    changes = {}
    for f in dataclasses.fields(record):
        value = getattr(record, f.name)
        if dataclasses.is_dataclass(value):
            changes[f.name] = _replace(value, values, f"{prefix}{f.name}.")
        else:
            changes[f.name] = values.get(prefix + f.name, value)
    return dataclasses.replace(record, **changes)
