# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The base record and the types of values that all parts of the task file's form share."""

from typing import Annotated, Any

import msgspec
from msgspec import Meta


class Record(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """Base of all records of a task file; a key that is not a field is an error.

    Records repeat `frozen` and `kw_only`, which they inherit, since mypy does not see that.
    """


Number = Annotated[float, Meta(ge=-1e12, le=1e12)]
Positive = Annotated[float, Meta(gt=0, le=1e12)]
NonNegative = Annotated[float, Meta(ge=0, le=1e12)]
Count = Annotated[int, Meta(ge=0, le=1_000_000)]
Bits = Annotated[int, Meta(ge=0, lt=2**31)]
Name = Annotated[str, Meta(min_length=1, max_length=200)]
Vector = tuple[Number, Number, Number]
Coordinates = Number | tuple[Number, ...]


def about(description: str, *examples: Any) -> Meta:
    """Returns a field's description and examples of its value."""
    return Meta(description=description, examples=list(examples) or None)
