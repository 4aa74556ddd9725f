# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a fault campaign keeps: bags, trainings, and messages that must be in the bags."""

import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.nodes.conftest import Process


@dataclass
class Recording:
    """A bag, and the times between which all that was published must be in it [s]."""

    path: Path
    windows: list[list[float]] = field(default_factory=list)  # begin and end of each
    killed: bool = False
    ended: bool = False

    @property
    def is_open(self) -> bool:
        return bool(self.windows) and self.windows[-1][1] == float("inf")

    def close(self, slack: float) -> None:
        """Ends the window: what came within the last `slack` seconds may be missing [s]."""
        if self.is_open:
            self.windows[-1][1] = time.monotonic() - slack

    def covers(self, moment: float) -> bool:
        return any(begin < moment < end for begin, end in self.windows)


@dataclass
class Training:
    """A training of the graph: its seed, its folder and the program that asked for it."""

    seed: int
    folder: Path
    program: Process


@dataclass
class Published:
    """A message that the graph published, as CDR, and when it came [s]."""

    time: float
    topic: str
    data: bytes
