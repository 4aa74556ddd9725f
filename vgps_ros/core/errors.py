# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Errors that a caller can act on: each message names the value and what would be right.

An entry of a file may be judged far from where its file is read. So an error gets its place there,
key by key, and who reads the file adds its name and line.
"""

from collections.abc import Iterator
from contextlib import contextmanager

Place = tuple[str | int, ...]  # keys and positions that lead to an entry


class VgpsError(Exception):
    """Base class of all errors that vgps_ros raises on purpose."""


class InvalidInputError(VgpsError, ValueError):
    """A value from outside has a wrong name, shape or range."""


class InvalidEntryError(InvalidInputError):
    """An entry of a file, or a change of a model, is wrong.

    Args:
        place: the entry, such as ("cost", 0, "sensor").
        sentence: what is wrong, and what would be right.
    """

    def __init__(self, place: Place, sentence: str):
        super().__init__(f"{'.'.join(map(str, place))}: {sentence}")
        self.place, self.sentence = place, sentence


@contextmanager
def at_entry(*place: str | int) -> Iterator[None]:
    """Gives errors within the block the place of an entry, before the place that they have."""
    try:
        yield
    except InvalidEntryError as error:
        raise InvalidEntryError((*place, *error.place), error.sentence) from error
    except InvalidInputError as error:
        raise InvalidEntryError(place, str(error)) from error


def refuse_if(is_wrong: bool, sentence: str, *place: str | int) -> None:
    """Raises an error about an entry if something is wrong."""
    if is_wrong:
        raise InvalidEntryError(place, sentence)


class DivergenceError(VgpsError, ArithmeticError):
    """A rollout or a solve left the range in which its numbers have a meaning.

    Args:
        sentence: what happened, and what to change.
        status: a name for the cause, one of STATUSES.
    """

    STATUSES = ("diverged", "infinite_cost", "indefinite_quu", "exploding_marginals", "open_gaps")

    def __init__(self, sentence: str, status: str = "diverged"):
        super().__init__(sentence)
        self.status = status
