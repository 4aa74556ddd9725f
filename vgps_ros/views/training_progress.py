# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Live progress of a training run on the terminal: a table that grows, and a bar with time left."""

import math

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from vgps_ros.search.metrics import IterationMetrics
from vgps_ros.views.table_console import plain_console

_ROW = "{:>9}  {:>6}  {:>10}  {:>13}  {:>8}  {:>11}  {:>9}"
_HEADER = ("iteration", "alpha", "stochastic", "deterministic", "DDP", "initial DDP", "time left")


class TrainingProgress(Progress):
    """One line an iteration; on a terminal also a bar, which moves during the first solve too."""

    def __init__(self, initial_ddp_iterations: int):
        console = plain_console()
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._initial = self.add_task("initial DDP", total=initial_ddp_iterations)
        self._learning = self.add_task("learning", total=None, visible=False)
        self._has_header = False

    def ddp_iteration(self, index: int) -> None:
        """Shows an iteration of the initial solve."""
        self.update(self._initial, completed=index)

    def iteration(self, metrics: IterationMetrics, iterations: int, remaining: float) -> None:
        """Shows one of so many iterations of Algorithm 1, and the time left [s]."""
        if not self._has_header:
            self.say(_ROW.format(*_HEADER))
            self._has_header = True
        costs = (
            metrics.stochastic_cost_mean,
            metrics.deterministic_cost,
            metrics.ddp_cost,
            metrics.initial_ddp_cost,
        )
        self.say(
            _ROW.format(
                f"{metrics.k}/{iterations}",
                f"{metrics.alpha:.2f}",
                *(f"{cost:.1f}" if math.isfinite(cost) else "diverged" for cost in costs),
                f"{remaining:.0f} s",
            )
        )
        self.update(self._initial, visible=False)
        self.update(self._learning, completed=metrics.k, total=iterations, visible=True)

    def say(self, line: str) -> None:
        """Prints a line above the bar."""
        # Not the console's own print, which would wrap lines where a log is narrow.
        if self.console.is_terminal:
            self.console.print(line, highlight=False, soft_wrap=True)
        else:
            print(line, flush=True)
