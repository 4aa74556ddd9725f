"""Live progress of a training run on the terminal."""

from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class TrainingProgress:
    """A bar on a terminal; elsewhere (a log, a pipe) a line an iteration."""

    def __init__(self, iterations: int, initial_ddp_iterations: int):
        self._console = Console()
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[costs]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._initial = self._bar.add_task(
            "initial DDP", total=initial_ddp_iterations, costs="", visible=True
        )
        self._learning = self._bar.add_task("learning", total=iterations, costs="", visible=False)
        self._iterations = iterations

    def __enter__(self) -> "TrainingProgress":
        """Starts the display."""
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends the display; what it showed last stays."""
        self._bar.stop()

    def ddp_iteration(self, index: int, cost: float) -> None:
        """Shows an iteration of the initial solve."""
        self._bar.update(self._initial, completed=index, costs=f"cost {cost:.1f}")

    def iteration(self, entry: dict[str, Any], initial_ddp_cost: float, remaining: float) -> None:
        """Shows an iteration of Algorithm 1, given its entry of result.json."""
        self._bar.update(self._initial, visible=False)
        costs = "  ".join(
            f"{label} {_number(value)}"
            for label, value in (
                ("alpha", entry["alpha"]),
                ("stochastic", entry["stochastic_cost_mean"]),
                ("deterministic", entry["deterministic_cost"]),
                ("DDP", entry["ddp_cost"]),
                ("initial DDP", initial_ddp_cost),
            )
        )
        self._bar.update(self._learning, completed=entry["k"], costs=costs, visible=True)
        if not self._console.is_terminal:
            left = f"{remaining:.0f} s left"
            print(f"iteration {entry['k']}/{self._iterations}  {costs}  {left}", flush=True)


def _number(value: float | None) -> str:
    if value is None:
        return "diverged"
    return f"{value:.2f}" if value < 10 else f"{value:.1f}"
