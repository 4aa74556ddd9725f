"""Which topics a recorder or a player takes, by regular expressions."""

import re
from collections.abc import Sequence

from vgps_ros.core.errors import InvalidInputError


class TopicFilter:
    """Topics that some pattern includes and none excludes.

    Args:
        include: regular expressions; one of them must be found in the topic's name.
        exclude: regular expressions; none of them may be found in it.

    Raises:
        InvalidInputError: one is not a regular expression.
    """

    def __init__(self, include: Sequence[str], exclude: Sequence[str]):
        self._include = _patterns("include", include)
        self._exclude = _patterns("exclude", exclude)

    def wants(self, topic: str) -> bool:
        """Returns whether the topic, named in full, is taken."""
        included = any(pattern.search(topic) for pattern in self._include)
        return included and not any(pattern.search(topic) for pattern in self._exclude)


def _patterns(name: str, expressions: Sequence[str]) -> list[re.Pattern[str]]:
    try:
        return [re.compile(expression) for expression in expressions]
    except re.error as error:
        raise InvalidInputError(
            f"{name} is {list(expressions)}, but each entry must be a regular expression: {error}."
        ) from error
