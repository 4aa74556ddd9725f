# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings that carry their own description and range.

A setting is declared once, in the record that uses it. From this `--help` prints its description
and range, a node declares its parameter, and values are checked.
"""

import dataclasses
import json
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any, TypeVar

from vgps_ros.core.checks import one_of, quote
from vgps_ros.core.errors import InvalidInputError

Record = TypeVar("Record")

_LONGEST = 1000  # the most values that a setting may list


@dataclass(frozen=True)
class Setting:
    """Description and range of one setting.

    Attributes:
        name: its name; that of a setting in a nested record is dotted, as in `fit.late`.
        default: its default; values must have the same type.
        description: a description of its effect, with its unit.
        minimum: smallest valid value, or None.
        maximum: largest valid value, or None.
        choices: valid values, or None.
    """

    name: str
    default: Any
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] | None = None

    def check(self, value: Any) -> None:
        """Checks a value.

        Raises:
            InvalidInputError: the value has another type than the default, or is out of range.
        """
        if not isinstance(self.default, tuple):
            self._check_one(value, self.default)
            return
        if not isinstance(value, tuple):
            raise InvalidInputError(
                f"{self.name} is {quote(value)}, but it must be a list of values."
            )
        if len(value) > _LONGEST:
            raise InvalidInputError(
                f"{self.name} has {len(value)} values, but at most {_LONGEST} are taken."
            )
        if not value:
            raise InvalidInputError(f"{self.name} is empty, but it must have at least one value.")
        for entry in value:
            self._check_one(entry, self.default[0])

    def _check_one(self, value: Any, example: Any) -> None:
        kind = type(example)
        wanted = (int, float) if kind is float else kind
        if not isinstance(value, wanted) or isinstance(value, bool) != (kind is bool):
            raise InvalidInputError(
                f"{self.name} is {quote(value)} of type {type(value).__name__}, but it must be of "
                f"type {kind.__name__}."
            )
        if self.choices:
            one_of(self.name, str(value), self.choices)
        low, high = self.minimum, self.maximum
        # Written so that NaN is refused.
        if (low is not None and not value >= low) or (high is not None and not value <= high):
            raise InvalidInputError(f"{self.name} is {value}, but it must be {self.range()}.")

    def range(self) -> str:
        """Returns the valid range in words, nothing where every value of the type is valid."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        low, high = (
            f"{limit:g}" if isinstance(limit, float) else str(limit)
            for limit in (self.minimum, self.maximum)
        )
        if self.minimum is not None and self.maximum is not None:
            return f"from {low} to {high}"
        if self.minimum is not None:
            return f"at least {low}"
        return "" if self.maximum is None else f"at most {high}"


def setting(default: Any, description: str, **limits: Any) -> Any:
    """Declares a field of a settings record; limits are minimum, maximum, choices of `Setting`."""
    return field(default=default, metadata={"description": description, **limits})


def settings_of(record: Any, prefix: str = "") -> Iterator[Setting]:
    """Yields the settings of a record, nested ones included, with its values as defaults."""
    for f in dataclasses.fields(record):
        value = getattr(record, f.name)
        if dataclasses.is_dataclass(value):
            yield from settings_of(value, f"{prefix}{f.name}.")
        else:
            yield Setting(prefix + f.name, value, **f.metadata)


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
