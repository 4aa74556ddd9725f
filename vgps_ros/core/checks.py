"""Checks of values that come from outside; each raises one sentence a user can act on."""

import math
import reprlib
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array

# Of a covariance's largest entry: the inverse of a badly scaled matrix is exact to no more.
_ROUNDING = 1e-3

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60
_SHORT.maxlist = _SHORT.maxtuple = 12


def quoted(value: Any) -> str:
    """Returns a value as a sentence can hold it: on one line, printable, and not too long."""
    text = ascii(value) if isinstance(value, str) and not value.isprintable() else None
    return _SHORT.repr(value) if text is None or len(text) > _SHORT.maxstring else text


def finite_array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Returns `values` as a float array of the given shape.

    Raises:
        InvalidInputError: the number of values does not fit the shape, or one is not finite.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInputError(f"{name} must hold numbers only: {error}.") from error
    size = math.prod(shape)  # of whole numbers without bounds, where NumPy's would wrap round
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
        InvalidInputError: it has not.
    """
    if np.shape(array) != shape:
        raise InvalidInputError(
            f"{name} has shape {np.shape(array)}, but it must have shape {shape}."
        )
    finite_array(name, array, shape)


def check_covariances(name: str, covariances: Array) -> None:
    """Checks that finite matrices, shape (N, n, n), are symmetric and positive semidefinite.

    Raises:
        InvalidInputError: one is not, by more than rounding.
    """
    largest = np.abs(covariances).max(axis=(1, 2), keepdims=True)
    scaled = covariances / np.where(largest > 0.0, largest, 1.0)
    skew = np.abs(scaled - scaled.transpose(0, 2, 1)).max(axis=(1, 2))
    smallest = np.linalg.eigvalsh(scaled)[:, 0]
    for wrong, what in (
        (skew > _ROUNDING, "symmetric"),
        (smallest < -_ROUNDING, "positive semidefinite"),
    ):
        if wrong.any():
            raise InvalidInputError(
                f"{name} is not {what} at step {np.flatnonzero(wrong)[0]}, as a covariance must be."
            )


def positive(name: str, value: float) -> float:
    """Returns `value` if it is finite and above zero.

    Raises:
        InvalidInputError: it is not.
    """
    if not (np.isfinite(value) and value > 0):
        raise InvalidInputError(f"{name} is {value}, but it must be finite and above 0.")
    return float(value)


def one_of(name: str, value: str, choices: Iterable[str]) -> str:
    """Returns `value` if it is among the choices.

    Raises:
        InvalidInputError: it is not.
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
