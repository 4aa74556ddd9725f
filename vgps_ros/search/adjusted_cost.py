# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The targets and weights of a cost that may be changed while plans are made."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.simulation.readings import Readings

LARGEST = 1e6  # of a target, in its unit, and of a weight


@dataclass(frozen=True)
class AdjustableCost:
    """A task's cost, of which those readings can be changed whose target and weight are constant.

    A reference that changes with time and what counts at the end of the horizon alone stay.

    Attributes:
        names: names of these readings.
        targets: their targets, shape (m,), in the units of the readings.
        weights: their weights, shape (m,).
    """

    names: tuple[str, ...]
    targets: Array
    weights: Array
    _cost: FeatureCost
    _columns: Array

    def __call__(self, targets: Sequence[float], weights: Sequence[float]) -> FeatureCost:
        """Returns the task's cost with other targets and weights.

        Raises:
            InvalidInputError: there is not one value for each reading.
        """
        cost, found = self._cost, {}
        for key, values in (("targets", targets), ("weights", weights)):
            self.check_count(values)
            found[key] = getattr(cost, key).copy()
            found[key][..., self._columns] = values
        return replace(cost, **found)

    def check_count(self, values: Sequence[float]) -> None:
        """Checks that there is one value for each reading.

        Raises:
            InvalidInputError: there is not.
        """
        if len(values) != len(self.names):
            raise InvalidInputError(
                f"{len(values)} values are given, but the cost has {len(self.names)} readings that "
                f"can be changed: {', '.join(self.names)}."
            )


def adjustable(cost: FeatureCost) -> AdjustableCost:
    """Returns what of a cost can be changed; nothing of one whose readings have no names."""
    names = cost.features.names if isinstance(cost.features, Readings) else ()
    targets, weights = (np.atleast_2d(values) for values in (cost.targets, cost.weights))
    constant = [
        i
        for i in range(len(names))
        if all((values[:, i] == values[0, i]).all() for values in (targets, weights))
    ]
    return AdjustableCost(
        names=tuple(names[i] for i in constant),
        targets=targets[0, constant],
        weights=weights[0, constant],
        _cost=cost,
        _columns=np.array(constant, dtype=np.intp),
    )
