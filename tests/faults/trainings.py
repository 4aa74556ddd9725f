# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A training that never ends: one after the other, each with a seed of its own."""

from pathlib import Path
from random import Random

from tests.faults.records import Training
from tests.nodes.conftest import Graph, Process

LEARNING = {"initial_ddp_iterations": 10, "evaluation_rollouts": 2}
HIDDEN_UNITS = 4


class Trainings:
    """The trainings that were asked for.

    Args:
        graph: where they run.
        iterations: of each.
        rng: draws their seeds.

    Attributes:
        iterations: of each.
        all: in the order in which they were begun.
        may_end_early: whether the learner was ended since, which cancels what it trains.
        finishing: whether the one under way is the last.
    """

    def __init__(self, graph: Graph, iterations: int, rng: Random):
        self._graph = graph
        self.iterations = iterations
        self._rng = rng
        self.all: list[Training] = []
        self.may_end_early = False
        self.finishing = False

    @property
    def running(self) -> bool:
        """Whether the last one is under way."""
        return bool(self.all) and self.all[-1].program.running

    def keep_going(self) -> None:
        """Begins the next one once the last has ended; one that was cancelled is asked for anew."""
        if self.finishing or self.running:
            return
        if self.all and self.all[-1].program.wait():
            last = self.all[-1]
            assert self.may_end_early, last.program.output
            last.program = self._ask(last.seed, last.folder)
            return
        self.may_end_early = False
        seed = self._rng.randrange(10**6)
        folder = self._graph.folder / f"training_{len(self.all)}"
        self.all.append(Training(seed, folder, self._ask(seed, folder)))

    def _ask(self, seed: int, folder: Path) -> Process:
        return self._graph.start(
            "train_through_graph",
            *("--iterations", str(self.iterations), "--seed", str(seed)),
            *("--hidden-units", str(HIDDEN_UNITS), "--output", str(folder)),
            *("--timeout", "60"),
        )
