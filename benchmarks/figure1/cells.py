# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs the cells of a comparison. Each cell is one training in a folder of its own."""

import hashlib
import itertools
import json
import re
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch

from benchmarks.figure1.curves import CURVES, configured, method_of
from vgps_ros.core.checks import nearest, one_of
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.search.training import train
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.tasks import BUILT_IN, make_task

PANELS = ("swimmer-5", "swimmer-10", "walker-5", "walker-10")  # the panels of Figure 1
_RUNS = "runs"
_UNFINISHED = ".unfinished-"


@dataclass(frozen=True, order=True)
class Panel:
    """A panel of the comparison: a task, and the number of the policy's hidden units."""

    task: str
    hidden_units: int

    @classmethod
    def named(cls, name: str) -> "Panel":
        """Returns the panel with a name such as `walker-10`.

        Raises:
            InvalidInputError: the name is not of the form TASK-UNITS, or the task is unknown.
        """
        match = re.fullmatch(r"(\w+)-([1-9]\d{0,3})", name)
        if match is None or match[1] not in BUILT_IN:
            raise InvalidInputError(
                f"panel is '{name}', but it must be all ({', '.join(PANELS)}) or TASK-UNITS with "
                f"a task of {', '.join(BUILT_IN)} and the number of hidden units."
                f"{nearest(name, (*PANELS, *(f'{task}-5' for task in BUILT_IN)))}"
            )
        return cls(match[1], int(match[2]))

    def __str__(self) -> str:
        """Returns the panel's name."""
        return f"{self.task}-{self.hidden_units}"


@dataclass(frozen=True)
class Protocol:
    """The settings that all cells of one experiment share.

    Attributes:
        iterations: number of policy updates.
        evaluation_rollouts: number of stochastic rollouts in each iteration.
        settings: a digest of all other settings of the tasks.
    """

    iterations: int
    evaluation_rollouts: int
    settings: str

    @classmethod
    def of(cls, iterations: int, evaluation_rollouts: int) -> "Protocol":
        """Returns the protocol with the settings of this version of the software."""
        tasks = [make_task(name) for name in BUILT_IN]
        limits = [(t.initial_std.tolist(), t.std_limit.tolist()) for t in tasks]
        pairs = [configured(task, curve) for task in tasks for curve in CURVES]
        settings = [(asdict(search), asdict(task.optimizer)) for task, search in pairs]
        digest = hashlib.sha256(json.dumps([limits, settings]).encode()).hexdigest()
        return cls(iterations, evaluation_rollouts, digest[:12])


@dataclass(frozen=True)
class Cell:
    """One training of an experiment.

    Attributes:
        panel: the panel that it belongs to.
        method: name of its curve, which is that of a method or `vgps_rising`.
        seed: seed of all random draws.
    """

    panel: Panel
    method: str
    seed: int

    def __str__(self) -> str:
        """Returns the cell's name in messages."""
        return f"{self.panel} {self.method} seed {self.seed}"

    def folder(self, root: Path) -> Path:
        """Returns the folder of the cell's results, which exists once the cell has finished."""
        return root / _RUNS / str(self.panel) / self.method / f"seed-{self.seed}"

    def is_finished(self, root: Path) -> bool:
        """Returns True if the folder of the cell's results exists."""
        return self.folder(root).is_dir()


def all_cells(panels: Sequence[Panel], methods: Sequence[str], seeds: Iterable[int]) -> list[Cell]:
    """Returns all combinations of panel, method and seed, ordered by their seeds.

    Raises:
        InvalidInputError: a method is unknown.
    """
    for method in methods:
        one_of("method", method, CURVES)
    each = itertools.product(seeds, dict.fromkeys(panels), dict.fromkeys(methods))
    return [Cell(panel, method, seed) for seed, panel, method in each]


def finished_cells(root: Path) -> list[Cell]:
    """Returns all cells whose results are in an experiment's folder."""
    cells = []
    for folder in sorted((root / _RUNS).glob("*/*/seed-*")):
        panel, method, seed = folder.parts[-3], folder.parts[-2], folder.name.removeprefix("seed-")
        if seed.isdigit() and method in CURVES:
            cells.append(Cell(Panel.named(panel), method, int(seed)))
    return cells


def remove_unfinished(root: Path) -> None:
    """Removes the files of cells that were stopped. No cell may be running."""
    for folder in (root / _RUNS).glob(f"*/*/*{_UNFINISHED}*"):
        shutil.rmtree(folder, ignore_errors=True)


def run_cell(cell: Cell, protocol: Protocol, root: Path) -> str:
    """Trains a cell. The folder of its results appears once all files are complete.

    Returns:
        The reason why the training failed, or "" if it succeeded.
    """
    silence_mujoco()  # in the worker, whose process is the experiment's
    # Each cell uses one thread, since cells run in parallel. The results do not depend on it.
    torch.set_num_threads(1)
    folder = cell.folder(root)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # The name is unique: a worker of an experiment that was killed may still train this cell.
        unfinished = Path(tempfile.mkdtemp(prefix=folder.name + _UNFINISHED, dir=folder.parent))
        task, settings = configured(make_task(cell.panel.task), cell.method)
        task.dynamics.simulations.threads = 1
        settings = replace(
            settings,
            iterations=protocol.iterations,
            evaluation_rollouts=protocol.evaluation_rollouts,
            hidden_units=(cell.panel.hidden_units,),
        )
        train(method_of(cell.method), task, settings, cell.seed, RunFolder(unfinished))
        if cell.is_finished(root):  # such a worker was faster; its numbers are the same
            shutil.rmtree(unfinished)
        else:
            unfinished.rename(folder)
    except Exception as error:  # no error of one cell may stop the others
        return f"{type(error).__name__}: {error}"
    return ""
