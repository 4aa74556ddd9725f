# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The settings of all that took part belong to a training's identity.

In a graph the optimizers have settings of their own, which may change between two solves: each
solve hands them back with its result, and all results of a training must have the same.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import settings_of
from vgps_ros.search.trajectory_optimization import OptimizationResult


def values_of(*records: Any) -> dict[str, Any]:
    """Returns the values of settings records by dotted name, as JSON reads them back."""
    values = {s.name: s.default for record in records for s in settings_of(record)}
    return dict(json.loads(json.dumps(values)))


def differences(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> tuple[str, str]:
    """Returns both sides' values where they differ, in words; empty where they agree."""
    names = [name for name, value in ours.items() if theirs.get(name) != value]
    first, second = (
        ", ".join(f"{name} {values.get(name)}" for name in names) for values in (theirs, ours)
    )
    return first, second


def check_one_optimizer(results: Sequence[OptimizationResult]) -> None:
    """Checks that all solves of a training, the first one first, were made by the same settings.

    Raises:
        InvalidInputError: a setting of a later solve differs.
    """
    begun, *later = (result.settings for result in results)
    for settings in later:
        if settings != begun:
            theirs, ours = differences(values_of(settings), values_of(begun))
            raise InvalidInputError(
                f"A trajectory optimizer solves with {theirs}, but the training was begun with "
                f"{ours}: start it with these values, or name another folder for the checkpoints "
                "to begin anew."
            )
