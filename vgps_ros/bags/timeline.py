# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Values of a bag by the times at which they came, where related topics may be somewhat late."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

SLACK = 10**9  # largest time by which the bag may hold one of two related messages late [ns]


@dataclass
class Timeline:
    """Values with the times at which they were received [ns], in this order."""

    received: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

    def add(self, received: int, value: Any) -> None:
        """Adds a value that came after all others."""
        self.received.append(received)
        self.values.append(value)

    def around(self, time: int) -> list[Any]:
        """Returns the values that may have been the latest at a time, the likeliest first."""
        first = max(0, int(np.searchsorted(self.received, time - SLACK, side="right")) - 1)
        last = int(np.searchsorted(self.received, time + SLACK, side="right"))
        now = int(np.searchsorted(self.received, time, side="right")) - 1
        return [self.values[i] for i in sorted(range(first, last), key=lambda i: abs(i - now))]
