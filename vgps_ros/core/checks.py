"""Checks of values that come from outside; each raises one sentence a user can act on."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array


def finite_array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Returns `values` as a float array of the given shape.

    Raises:
        InvalidInputError: the number of values does not fit the shape, or one is not finite.
    """
    array = np.array(values, dtype=float)
    if array.size != int(np.prod(shape)):
        raise InvalidInputError(
            f"{name} has {array.size} values, but shape {shape} needs {int(np.prod(shape))}."
        )
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise InvalidInputError(
            f"{name} is {array.flat[bad[0]]} at index {bad[0]}; every value must be finite."
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
        raise InvalidInputError(f"{name} is '{value}', but it must be one of {', '.join(names)}.")
    return value
