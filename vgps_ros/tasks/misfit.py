# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Explains in a sentence why a file's data do not fit a record.

msgspec judges the data, but its errors name neither a line, nor the nearest key, nor an example. So
this module descends to the innermost entry that msgspec refuses, and says what would fit there.
"""

import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec
import yaml
from msgspec import Meta
from msgspec.structs import fields

from vgps_ros.core.checks import nearest, quoted
from vgps_ros.tasks.document import Document, Place

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
