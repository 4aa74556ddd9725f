# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A comparison of two times, and how it is measured."""

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

WARM_UPS = 2  # calls of each before the first that counts


@dataclass(frozen=True)
class Comparison:
    """One row of the table.

    Attributes:
        name: what is compared, with whom.
        ours: median of ours, in `unit`.
        peer: median of the peer's, or of the floor.
        target: what `ratio` must not pass; None where it is only told.
        unit: of `ours` and `peer`; a unit that ends in "/s" is a rate, of which more is better.
        spread: half the distance between the quartiles of the ratios of single calls.
        remark: what a reader must know to judge it.
        curve: sizes and times [s] of a growth, for the picture.
    """

    name: str
    ours: float
    peer: float
    target: float | None
    unit: str = "ms"
    spread: float | None = None
    remark: str = ""
    curve: tuple[tuple[float, float], ...] = ()

    @property
    def ratio(self) -> float:
        """Ours divided by the peer's."""
        return self.ours / self.peer

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without one."""
        if self.target is None:
            return None
        return self.ratio >= self.target if self.unit.endswith("/s") else self.ratio <= self.target

    def entry(self) -> dict[str, Any]:
        """Returns the row as it stands in benchmarks.json."""
        return {**asdict(self), "ratio": self.ratio, "met": self.met}


def compare(
    name: str,
    ours: Callable[[], Any],
    peer: Callable[[], Any],
    target: float | None,
    *,
    repetitions: int = 15,
    remark: str = "",
) -> Comparison:
    """Times two functions in turns, so that other work on the machine slows both alike."""
    for _ in range(WARM_UPS):
        ours()
        peer()
    pairs = [(seconds(ours), seconds(peer)) for _ in range(repetitions)]
    quartiles = statistics.quantiles([a / b for a, b in pairs], n=4)
    mine, theirs = (1e3 * statistics.median(column) for column in zip(*pairs, strict=True))
    spread = 0.5 * (quartiles[2] - quartiles[0])
    return Comparison(name, mine, theirs, target, spread=spread, remark=remark)


def seconds(work: Callable[[], Any]) -> float:
    """Returns how long one call takes on the wall's clock [s]."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began
