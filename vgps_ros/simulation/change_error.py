# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The error of a change that does not suit a model, which knows the place of the change."""

from collections.abc import Iterator
from contextlib import contextmanager

from vgps_ros.core.errors import InvalidInputError

Place = tuple[str | int, ...]


class InvalidChangeError(InvalidInputError):
    """A change does not suit the model.

    Args:
        place: keys that lead to the change, such as ("changes", "joints", "hip").
        sentence: what is wrong, and what would be right.
    """

    def __init__(self, place: Place, sentence: str):
        super().__init__(f"{'.'.join(map(str, place))}: {sentence}")
        self.place, self.sentence = place, sentence


@contextmanager
def change_at(*place: str | int) -> Iterator[None]:
    """Gives the errors of a block the place of a change."""
    try:
        yield
    except InvalidInputError as error:
        raise InvalidChangeError(place, str(error)) from error
