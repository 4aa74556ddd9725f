"""The cells of a comparison: one training each, in a folder of its own."""

import itertools
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from vgps_ros.core.checks import one_of
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.experiments.training import train
from vgps_ros.search.methods import METHODS
from vgps_ros.search.settings import search_settings
from vgps_ros.tasks import TASKS, make_task

PANELS = ("swimmer-5", "swimmer-10", "walker-5", "walker-10")  # of Figure 1
_RUNS = "runs"
_UNFINISHED = ".unfinished"


@dataclass(frozen=True, order=True)
class Panel:
    """A task and a size of policy."""

    task: str
    hidden_units: int

    @classmethod
    def named(cls, name: str) -> "Panel":
        """Returns the panel of a name such as `walker-10`.

        Raises:
            InvalidInputError: there is none.
        """
        match = re.fullmatch(r"(\w+)-([1-9]\d{0,3})", name)
        if match is None or match[1] not in TASKS:
            raise InvalidInputError(
                f"panel is '{name}', but it must be all ({', '.join(PANELS)}) or TASK-UNITS with "
                f"a task of {', '.join(sorted(TASKS))} and the number of hidden units."
            )
        return cls(match[1], int(match[2]))

    def __str__(self) -> str:
        """Returns its name."""
        return f"{self.task}-{self.hidden_units}"


@dataclass(frozen=True)
class Protocol:
    """What all cells of one experiment have in common."""

    iterations: int
    evaluation_rollouts: int


@dataclass(frozen=True)
class Cell:
    """One training."""

    panel: Panel
    method: str
    seed: int

    def __str__(self) -> str:
        """Returns what to call it in a message."""
        return f"{self.panel} {self.method} seed {self.seed}"

    def folder(self, root: Path) -> Path:
        """Returns where its results lie once it has finished."""
        return root / _RUNS / str(self.panel) / self.method / f"seed-{self.seed}"

    def is_finished(self, root: Path) -> bool:
        """Returns whether its results are there."""
        return self.folder(root).is_dir()


def all_cells(panels: Sequence[Panel], methods: Sequence[str], seeds: int) -> list[Cell]:
    """Returns all combinations; a seed of every one before the next seed of any.

    Raises:
        InvalidInputError: a method is unknown.
    """
    for method in methods:
        one_of("method", method, METHODS)
    return [Cell(p, m, seed) for seed, p, m in itertools.product(range(seeds), panels, methods)]


def finished_cells(root: Path) -> list[Cell]:
    """Returns all cells whose results lie in an experiment's folder."""
    folders = sorted((root / _RUNS).glob("*/*/seed-*"))
    return [
        Cell(Panel.named(f.parts[-3]), f.parts[-2], int(f.name.removeprefix("seed-")))
        for f in folders
        if f.suffix != _UNFINISHED
    ]


def run_cell(cell: Cell, protocol: Protocol, root: Path) -> str:
    """Trains a cell; its folder appears when all of it is there.

    Returns:
        Why it failed, or nothing.
    """
    # One cell, one thread: cells share the processors, and no number depends on how many they are.
    torch.set_num_threads(1)
    folder = cell.folder(root)
    unfinished = folder.with_name(folder.name + _UNFINISHED)
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        task = make_task(cell.panel.task)
        task.dynamics.threads = 1
        settings = replace(
            search_settings(task),
            iterations=protocol.iterations,
            evaluation_rollouts=protocol.evaluation_rollouts,
            hidden_units=(cell.panel.hidden_units,),
        )
        train(cell.method, task, settings, cell.seed, unfinished)
        unfinished.rename(folder)
    except (VgpsError, OSError, ArithmeticError, ValueError, RuntimeError) as error:
        return f"{type(error).__name__}: {error}"
    return ""
