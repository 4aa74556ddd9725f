# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Consoles for tables, and the live progress of a training on the terminal.

Names, paths and units come from outside, so nothing in what is printed is markup: of `a[/b]` or
`[m, rad]` no letter is taken for a style. What needs a style gets it beside the text.
"""

import math

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from vgps_ros.core.slow_steps import progress_lines
from vgps_ros.search.metrics import IterationMetrics

_WIDE = 140  # characters; more than any table needs
_ROW = "{:>9}  {:>6}  {:>10}  {:>13}  {:>8}  {:>11}  {:>9}"
_HEADER = ("iteration", "alpha", "stochastic", "deterministic", "DDP", "initial DDP", "time left")


def plain_console() -> Console:
    """Returns a console on the standard output that prints each text as it is."""
    return Console(markup=False, emoji=False)


def table_console(*, wide: bool = False) -> Console:
    """Returns a plain console that is wide enough for tables.

    It is as wide as the terminal. Without a terminal, rich would assume 80 characters and cut the
    tables, so the console is then as wide as any table needs.

    Args:
        wide: whether to take the full width on a narrow terminal too, which then breaks the lines.
    """
    console = plain_console()
    if wide or not console.is_terminal:
        console.width = max(console.width, _WIDE)
    return console


class TrainingProgress(Progress):
    """One line an iteration; on a terminal also a bar, which moves during the first solves too."""

    def __init__(self) -> None:
        console = plain_console()
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._initial = self.add_task("first solutions", total=1.0)
        self._initial_lines = progress_lines("First solutions")
        self._learning = self.add_task("learning", total=None, visible=False)
        self._has_header = False

    def initial_solves(self, share: float) -> None:
        """Shows how much of the initial solves is done; without a terminal, every 10 s."""
        self.update(self._initial, completed=share)
        if not self.console.is_terminal:
            self._initial_lines(share)

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
        solved = f"{metrics.found_situations} of {metrics.new_situations}"
        new = f"  {solved} new situations solved" if metrics.new_situations else ""
        self.say(
            _ROW.format(
                f"{metrics.k}/{iterations}",
                f"{metrics.alpha:.2f}",
                *(f"{cost:.1f}" if math.isfinite(cost) else "diverged" for cost in costs),
                f"{remaining:.0f} s",
            )
            + new
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
