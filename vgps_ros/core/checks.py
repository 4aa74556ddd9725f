# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks values that come from outside; each check raises a sentence that a user can act on."""

import math
import reprlib
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vgps_ros.core.arrays import Array, arrays_of, declared_shapes
from vgps_ros.core.errors import InvalidInputError

# Tolerance relative to a covariance's largest entry: inverses of badly scaled matrices err so far.
LARGEST_ROUNDING = 1e-3

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60
_SHORT.maxlist = _SHORT.maxtuple = 12


def quoted(value: Any) -> str:
    """Returns a value as a sentence can hold it: on one line, printable, and not too long."""
    text = ascii(value) if isinstance(value, str) and not value.isprintable() else None
    return _SHORT.repr(value) if text is None or len(text) > _SHORT.maxstring else text


def printable(text: str) -> str:
    """Returns a text with escapes in place of what would command a terminal; line breaks stay."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def told(error: Exception) -> str:
    """Returns what a library says of an error, as a sentence can end with it: on one short line."""
    return f"{' '.join(str(error).split()):.200}".rstrip(". ")


def finite_array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Returns `values` as a float array of the given shape.

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
    if not finite.all():
        first = int(np.argmin(finite))
        raise InvalidInputError(
            f"{name} is {array.flat[first]} at index {first}; every value must be finite."
        )
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
    smallest = np.linalg.eigvalsh(scaled)[:, 0]
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
        record: one whose arrays are declared with `core.arrays.Shape`.
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
            f"{name} is {quoted(value)}, but it must be one of {', '.join(names)}."
            f"{nearest(value, names)}"
        )
    return value


def nearest(word: str, choices: Iterable[str]) -> str:
    """Returns a question that names the choice most like a word; empty where none is like it."""
    found = get_close_matches(word, list(choices), 1)
    return f" Did you mean '{found[0]}'?" if found else ""
