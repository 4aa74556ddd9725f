# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Arrays that are fields of records, and checks of values that come from outside.

A field such as `gains: Annotated[Array, Shape("T", "n_u", "n_x")]` names its sizes by symbols.
Files, messages and checks ask here which arrays a record has and which shape each must have. The
name of an array in a nested record is dotted, as in "mean.states". Each check raises a sentence
that a user can act on.
"""

import math
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vgps_ros.core.errors import InvalidInputError

Array = NDArray[np.float64]
Record = TypeVar("Record")

# Tolerance relative to a covariance's largest entry: inverses of badly scaled matrices err so far.
LARGEST_ROUNDING = 1e-3

_MOST_LISTED = 12  # names in a sentence
_SLIP = 0.85  # likeness of two words from which on one is the other, misspelt

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60
_SHORT.maxlist = _SHORT.maxtuple = 12


class Shape:
    """Declares the shape of a field that is an array.

    Args:
        sizes: a symbol for each axis; "T+1" is one more than "T".
        is_covariance: whether the matrices must be symmetric and positive semidefinite.
    """

    def __init__(self, *sizes: str, is_covariance: bool = False):
        self.sizes = sizes
        self.is_covariance = is_covariance

    def of(self, values: Mapping[str, int]) -> tuple[int, ...]:
        """Returns the shape as numbers, where the symbols have these values."""
        return tuple(values[size.removesuffix("+1")] + size.endswith("+1") for size in self.sizes)


def declared_shapes(kind: Any) -> dict[str, Shape]:
    """Returns the declarations of a record type's arrays by name, nested records included."""
    found: dict[str, Shape] = {}
    for f in fields(kind):
        if is_dataclass(f.type):
            found |= {f"{f.name}.{name}": shape for name, shape in declared_shapes(f.type).items()}
        for note in getattr(f.type, "__metadata__", ()):
            found[f.name] = note
    return found


def array_shapes(kind: Any, **values: int) -> dict[str, tuple[int, ...]]:
    """Returns the shapes of a record type's arrays by name, for these values of the symbols."""
    return {name: shape.of(values) for name, shape in declared_shapes(kind).items()}


def arrays_of(record: Any) -> dict[str, Array]:
    """Returns a record's arrays by name."""
    return {name: attrgetter(name)(record) for name in declared_shapes(type(record))}


def from_arrays(kind: type[Record], arrays: Mapping[str, Array]) -> Record:
    """Returns a record, all of whose fields are arrays or such records, from arrays by name."""
    values: dict[str, Any] = {}
    for f in fields(kind):  # type: ignore[arg-type]
        if is_dataclass(f.type):
            inner = {
                n.partition(".")[2]: a for n, a in arrays.items() if n.startswith(f"{f.name}.")
            }
            values[f.name] = from_arrays(f.type, inner)  # type: ignore[arg-type]
        else:
            values[f.name] = arrays[f.name]
    return kind(**values)


def first_steps(record: Record, steps: int) -> Record:
    """Returns a record's first steps: its arrays over T or T+1 steps are cut to T = `steps`."""
    declared = declared_shapes(type(record))
    cut = {n: a[: steps + declared[n].sizes[0].count("+1")] for n, a in arrays_of(record).items()}
    return from_arrays(type(record), cut)


def quote(value: Any) -> str:
    """Returns a value as a sentence can hold it: on one line, printable, and not too long."""
    text = ascii(value) if isinstance(value, str) and not value.isprintable() else None
    return _SHORT.repr(value) if text is None or len(text) > _SHORT.maxstring else text


def printable(text: str) -> str:
    """Returns a text with escapes in place of what would command a terminal; line breaks stay."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def error_text(error: Exception) -> str:
    """Returns what a library says of an error, as a sentence can end with it: on one short line."""
    return f"{' '.join(str(error).split()):.200}".rstrip(". ")


def finite_array(
    name: str, values: ArrayLike, shape: tuple[int, ...], owners: Sequence[str] = ()
) -> Array:
    """Returns `values` as a float array of the given shape.

    An error says whose value is wrong, if their owners are known, or else its index.

    Raises:
        InvalidInputError: the number of values does not fit the shape, or one is not finite.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInputError(f"{name} must hold numbers only: {error}.") from error
    size = math.prod(shape)  # in unbounded integers, which do not overflow as NumPy's do
    if array.size != size:
        raise InvalidInputError(f"{name} has {array.size} values, but shape {shape} needs {size}.")
    finite = np.isfinite(array)
    if np.count_nonzero(finite) < size:  # in a third of the time of all()
        first = int(np.argmin(finite))
        value = f"{array.flat[first]}{'' if owners else f' at index {first}'}"
        whose = f" of {quote(owners[first])}" if owners else ""
        raise InvalidInputError(f"{name}{whose} is {value}; every value must be finite.")
    return array.reshape(shape)


def check_array(name: str, array: Array, shape: tuple[int, ...]) -> None:
    """Checks that an array has a shape and finite values.

    Raises:
        InvalidInputError: the shape is another one, or a value is not finite.
    """
    if np.shape(array) != shape:
        raise InvalidInputError(
            f"{name} has shape {np.shape(array)}, but it must have shape {shape}."
        )
    finite_array(name, array, shape)


def check_covariances(name: str, covariances: Array) -> None:
    """Checks that finite matrices, shape (N, n, n), are symmetric and positive semidefinite.

    Raises:
        InvalidInputError: a matrix differs from that by more than rounding.
    """
    largest = np.abs(covariances).max(axis=(1, 2), keepdims=True)
    scaled = covariances / np.where(largest > 0.0, largest, 1.0)
    skew = np.abs(scaled - scaled.transpose(0, 2, 1)).max(axis=(1, 2))
    try:  # which takes a small part of the time that eigenvalues take
        np.linalg.cholesky(scaled + LARGEST_ROUNDING * np.eye(scaled.shape[1]))
        smallest = np.zeros(len(scaled))
    except np.linalg.LinAlgError:
        smallest = np.asarray(np.linalg.eigvalsh(scaled)[:, 0], float)
    for wrong, what in (
        (skew > LARGEST_ROUNDING, "symmetric"),
        (smallest < -LARGEST_ROUNDING, "positive semidefinite"),
    ):
        if wrong.any():
            raise InvalidInputError(
                f"{name} is not {what} at step {np.flatnonzero(wrong)[0]}, as a covariance must be."
            )


def check_record(name: str, record: Any, **sizes: int) -> None:
    """Checks that a record's arrays have the shapes that it declares, and fit values.

    Args:
        name: what the sentence calls the record.
        record: one whose arrays are declared with `Shape`.
        sizes: value of each symbol in the declared shapes, such as T and n_x.

    Raises:
        InvalidInputError: a shape is wrong, a value is not finite, or a matrix is no covariance.
    """
    declared = declared_shapes(type(record))
    for path, values in arrays_of(record).items():
        check_array(f"{name}.{path}", values, declared[path].of(sizes))
        if declared[path].is_covariance:
            check_covariances(f"{name}.{path}", values)


def positive(name: str, value: float) -> float:
    """Returns `value` if it is finite and above zero.

    Raises:
        InvalidInputError: the value is not finite or not above zero.
    """
    if not (np.isfinite(value) and value > 0):
        raise InvalidInputError(f"{name} is {value}, but it must be finite and above 0.")
    return float(value)


def one_of(name: str, value: str, choices: Iterable[str]) -> str:
    """Returns `value` if it is among the choices.

    Raises:
        InvalidInputError: the value is none of the choices.
    """
    names = sorted(choices)
    if value not in names:
        raise InvalidInputError(
            f"{name} is {quote(value)}, but it must be one of {', '.join(names)}."
            f"{nearest(value, names)}"
        )
    return value


def nearest(word: str, choices: Iterable[str]) -> str:
    """Returns a question that names the choice most like a word; empty where none is like it."""
    found = get_close_matches(word, list(choices), 1)
    return f" Did you mean '{found[0]}'?" if found else ""


def check_spelling(what: str, words: Iterable[str], known: Iterable[str]) -> None:
    """Checks that no unknown word is a known one with a slip; others are left alone.

    Raises:
        InvalidInputError: one is.
    """
    known = list(known)
    for word in words:
        if word not in known and (found := get_close_matches(word, known, 1, _SLIP)):
            raise InvalidInputError(
                f"{what} has {quote(word)}, which is not known. Did you mean '{found[0]}'?"
            )


def matching_names(what: str, pattern: str, names: Sequence[str]) -> list[str]:
    """Returns the names that a pattern matches, in their order.

    Args:
        what: what has these names, such as `joint`.
        pattern: a name, which matches itself alone, or a pattern with *, ? or [abc].
        names: all names. The pattern `*` may match none.

    Raises:
        InvalidInputError: no name matches; the sentence has the names, and the nearest one.
    """
    if pattern in names:
        return [pattern]
    found = [name for name in names if fnmatchcase(name, pattern)]
    if not found and pattern != "*":
        raise _unknown_error(f"{quote(pattern)} matches no {what}", pattern, names)
    return found


def find_name(what: str, name: str, names: Sequence[str]) -> str:
    """Returns a name if it is among the names.

    Raises:
        InvalidInputError: it is not; the sentence has the names, and the nearest one.
    """
    if name not in names:
        raise _unknown_error(f"there is no {what} {quote(name)}", name, names)
    return name


def list_names(names: Sequence[str]) -> str:
    """Returns the first of some names, as a sentence lists them."""
    shown = ", ".join(quote(name).strip("'") for name in names[:_MOST_LISTED])
    return f"{shown} and others" if len(names) > _MOST_LISTED else shown or "none"


def _unknown_error(complaint: str, name: str, names: Sequence[str]) -> InvalidInputError:
    return InvalidInputError(f"{complaint}; there are {list_names(names)}.{nearest(name, names)}")
