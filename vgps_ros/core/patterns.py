# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds names by patterns such as `*_hip`, for settings that name many things at once."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from vgps_ros.core.checks import nearest, quoted
from vgps_ros.core.errors import InvalidInputError

_MOST_LISTED = 12


def matching(what: str, pattern: str, names: Sequence[str]) -> list[str]:
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
        raise _unknown(f"{quoted(pattern)} matches no {what}", pattern, names)
    return found


def known(what: str, name: str, names: Sequence[str]) -> str:
    """Returns a name if it is among the names.

    Raises:
        InvalidInputError: it is not; the sentence has the names, and the nearest one.
    """
    if name not in names:
        raise _unknown(f"there is no {what} {quoted(name)}", name, names)
    return name


def listed(names: Sequence[str]) -> str:
    """Returns the first of some names, as a sentence lists them."""
    shown = ", ".join(quoted(name).strip("'") for name in names[:_MOST_LISTED])
    return f"{shown} and others" if len(names) > _MOST_LISTED else shown or "none"


def _unknown(complaint: str, name: str, names: Sequence[str]) -> InvalidInputError:
    return InvalidInputError(f"{complaint}; there are {listed(names)}.{nearest(name, names)}")
