# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Valid messages broken in every way that their types allow, drawn by hypothesis.

A message is broken in one to three places: a number becomes NaN, infinite, huge, negative or zero,
a string becomes another one, a list gets longer, shorter, empty or repeats itself.
"""

import copy
from array import array
from collections.abc import Callable, Iterator
from typing import Any

import hypothesis.strategies as st
from rclpy.serialization import serialize_message

DOUBLES = (*map(float, ("nan", "inf", "-inf")), 1e308, -1e308, 1e150, 5e-324, -1.0, 0.0, 0.5)
STRINGS = (
    "",
    "nan",
    "../../etc/passwd",
    "\x00",
    "%s%n{0}",
    "\x1b[31mred\nand a line",
    "' OR 1=1",
    "ロボット" * 50,
    "x" * 10_000,
)
BITS = {"int8": 7, "int16": 15, "int32": 31, "int64": 63}
BITS |= {"uint8": 8, "octet": 8, "byte": 8, "uint16": 16, "uint32": 32, "uint64": 64}

Place = tuple[Any, str, str]
"""A message, the name of one of its fields, and the field's type."""


def broken(*valid: Any) -> st.SearchStrategy[Any]:
    """Draws a copy of one of the valid messages and breaks it."""

    @st.composite
    def draw_broken(draw: Callable[[st.SearchStrategy[Any]], Any]) -> Any:
        message = copy.deepcopy(draw(st.sampled_from(valid)))
        for _ in range(draw(st.sampled_from((1, 1, 1, 2, 3)))):
            owner, field, kind = draw(st.sampled_from(list(_places(message))))
            setattr(owner, field, draw(_values(kind, getattr(owner, field))))
        return message

    return draw_broken()


def cut(message: Any) -> st.SearchStrategy[bytes]:
    """Draws the message's CDR, cut short or with bytes changed."""
    data = serialize_message(message)

    def change(length: int, changes: list[tuple[int, int]]) -> bytes:
        changed = bytearray(data[:length])
        for at, byte in changes:
            if at < len(changed):
                changed[at] = byte
        return bytes(changed)

    places = st.integers(4, max(4, min(len(data) - 1, 200)))
    changes = st.lists(st.tuples(places, st.integers(0, 255)), max_size=4)
    return st.builds(change, st.integers(4, len(data)), changes)


def huge(valid: Any, count: int = 1_000_000) -> Iterator[Any]:
    """Yields the message with each of its lists blown up in turn."""
    for index, (_, _, kind) in enumerate(_places(valid)):
        if not kind.startswith("sequence<") or "/" in kind:
            continue
        message = copy.deepcopy(valid)
        owner, field, _ = list(_places(message))[index]
        value = getattr(owner, field)
        few = count if isinstance(value, array) else count // 50
        filler = value[0] if len(value) else ("x" if kind == "sequence<string>" else 1)
        setattr(owner, field, type(value)(value.typecode, [filler]) * few
                if isinstance(value, array) else [filler] * few)  # fmt: skip
        yield message


def _places(message: Any) -> Iterator[Place]:
    for field, kind in message.get_fields_and_field_types().items():
        if kind.endswith("]"):  # of a fixed length, as covariances, which no node reads
            continue
        yield message, field, kind
        value = getattr(message, field)
        for inner in value[:2] if isinstance(value, list) else [value]:
            if hasattr(inner, "get_fields_and_field_types"):
                yield from _places(inner)


def _values(kind: str, value: Any) -> st.SearchStrategy[Any]:
    if kind.startswith("sequence<"):
        return _lists(kind.removeprefix("sequence<").split(",")[0].rstrip(">"), value)
    if kind.endswith("]"):  # an array of a fixed size
        size, scalar = len(value), _scalars(kind.partition("[")[0])
        return st.lists(scalar, min_size=size, max_size=size)
    if "/" in kind:  # a message: its fields are places of their own
        return st.just(type(value)())
    return _scalars(kind)


def _scalars(kind: str) -> st.SearchStrategy[Any]:
    if kind == "boolean":
        return st.booleans()
    if kind in ("double", "float"):
        # A float has no 1e308.
        return st.sampled_from(DOUBLES if kind == "double" else (*DOUBLES[:3], 1e38, -1.0, 0.0))
    if kind == "string":
        letters = st.characters(exclude_categories=["Cs"])
        return st.sampled_from(STRINGS) | st.text(letters, max_size=20)
    if kind in ("octet", "byte"):
        return st.sampled_from([b"\x00", b"\x01", b"\xff"])
    top = 2 ** BITS[kind] - 1
    bottom = 0 if kind.startswith("u") else -top - 1
    return st.sampled_from((0, 1, 2, 50, top, top - 1, top // 2, bottom))


def _lists(kind: str, value: Any) -> st.SearchStrategy[Any]:
    """Lists of scalars are changed; lists of messages lose or repeat entries."""
    items = list(value)
    one = items[:1]
    if "/" in kind:
        return st.sampled_from([[], one])
    spoilt = st.builds(
        lambda at, new: [*items[: at % (len(items) + 1)], new, *items[at % (len(items) + 1) + 1 :]],
        st.integers(0, 10_000),
        _scalars(kind),
    )
    sizes = st.sampled_from([[], items[:-1], [*items, *one], items * 2, items[::-1], one * 3])
    everywhere = _scalars(kind).map(lambda new: [new] * max(len(items), 1))
    kept = st.one_of(spoilt, sizes, everywhere)
    if isinstance(value, array):
        return kept.map(lambda values: array(value.typecode, values))
    return kept
