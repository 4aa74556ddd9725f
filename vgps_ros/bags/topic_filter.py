# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Chooses the topics that a recorder or a player takes, by regular expressions."""

import re
from collections.abc import Sequence

from vgps_ros.core.errors import InvalidInputError


class TopicFilter:
    """Takes the topics that at least one pattern includes and no pattern excludes.

    Args:
        include: regular expressions, of which at least one must be found in a topic's name.
        exclude: regular expressions, of which none may be found in a topic's name.

    Raises:
        InvalidInputError: an entry is not a regular expression.
    """

    def __init__(self, include: Sequence[str], exclude: Sequence[str]):
        self._include = _patterns("include", include)
        self._exclude = _patterns("exclude", exclude)

    def wants(self, topic: str) -> bool:
        """Returns True if a topic is taken, given its full name."""
        included = any(pattern.search(topic) for pattern in self._include)
        return included and not any(pattern.search(topic) for pattern in self._exclude)


def _patterns(name: str, expressions: Sequence[str]) -> list[re.Pattern[str]]:
    try:
        return [re.compile(expression) for expression in expressions]
    except re.error as error:
        raise InvalidInputError(
            f"{name} is {list(expressions)}, but each entry must be a regular expression: {error}."
        ) from error
