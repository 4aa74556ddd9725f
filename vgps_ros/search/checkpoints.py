# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checkpoints of a policy search: a run that was killed goes on and ends with the same bits.

A checkpoint is one NumPy archive: the arrays, and all the rest as JSON text. Reading it can run no
code. It holds no state of a random generator, for there is none to hold: every draw has a generator
of its own, named by seed, purpose and place in the run (see `core/seeding.py`).

Iterations of even and odd k are kept in two files by turns, each replaced in one piece. So the last
two are always there, and what a run went on from is not touched before there is a later one.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.settings import differences, values_of
from vgps_ros.search.iteration import SearchState
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.workspace import Update
from vgps_ros.storage.files import from_entries, part_of, read_archive, to_tree, write_archive
from vgps_ros.tasks import Task
from vgps_ros.tasks.task import task_digest

FORMAT = 13  # of the files; a change of the records that they hold is a new one
_CONTENT = "content"  # name of the JSON text in the archive
_CONTENT_OF_TASK = "content of the task"  # as a sentence names its digest


@dataclass(frozen=True)
class Run:
    """The training that a checkpoint belongs to."""

    method: str
    task: Task
    settings: SearchSettings
    seed: int
    first_policy: GaussianPolicy | None = None

    def identity(self) -> dict[str, Any]:
        """Returns all that the numbers of the run depend on, as JSON values by name."""
        first = self.first_policy
        return {
            "format": FORMAT,
            "task": self.task.name,
            _CONTENT_OF_TASK: task_digest(self.task),
            "method": self.method,
            "seed": self.seed,
            "first policy": first and hashlib.sha256(first.parameters.tobytes()).hexdigest()[:12],
            **values_of(self.settings, self.task.optimizer),
        }

    def name(self) -> str:
        """Returns a name for a folder, which no other run has."""
        digest = hashlib.sha256(json.dumps(self.identity()).encode()).hexdigest()[:12]
        return f"{self.task.name}-{self.method}-seed-{self.seed}-{digest}"


class Checkpoints:
    """Keeps the last two checkpoints of one run in a folder.

    Args:
        folder: made with the first checkpoint.
        tell: takes a sentence on where a run goes on from, and on each file that is refused.
        overwrite: whether checkpoints of another run are replaced, in place of a refusal.
    """

    def __init__(
        self, folder: Path, tell: Callable[[str], None] = lambda _: None, *, overwrite: bool = False
    ):
        self.folder = folder
        self.tell = tell
        self.overwrite = overwrite

    def save(self, run: Run, state: SearchState) -> None:
        """Writes a checkpoint in one piece.

        Raises:
            OSError: it cannot be written; the two before it are still there.
        """
        arrays: dict[str, Array] = {}
        content = {"run": run.identity(), "state": to_tree(state, arrays)}
        text = np.frombuffer(json.dumps(content).encode(), dtype=np.uint8)
        self.folder.mkdir(parents=True, exist_ok=True)
        write_archive(self._path(state.k), {_CONTENT: text, **arrays})

    def latest(self, run: Run, kind: type[Update]) -> SearchState | None:
        """Returns the state to go on from; None if there is none.

        A file that is not whole is refused with a sentence, and the one before it is used. The kind
        is what the iterations of the run's method end with.

        Raises:
            InvalidInputError: there are only checkpoints of another run, and they stay.
        """
        found: list[SearchState] = []
        refused: list[Exception] = []
        for path in (self._path(0), self._path(1)):
            try:
                found.append(_load(path, run, kind))
            except FileNotFoundError:  # noqa: PERF203
                continue
            except ForeignCheckpointError as error:
                refused.insert(0, error)
            except Exception as error:  # not a valid checkpoint
                self.tell(f"'{path}' is not a whole checkpoint and is left out: {error}")
                refused.append(error)
        if found:
            for other in refused:
                if isinstance(other, ForeignCheckpointError):  # else the run ends with it
                    self.tell(str(other))
            state = max(found, key=lambda one: one.k)
            self.tell(f"Going on from iteration {state.k} of {run.settings.iterations}.")
            return state
        if refused and isinstance(refused[0], ForeignCheckpointError):
            if not self.overwrite:
                raise refused[0]
            self.tell(f"The checkpoints of another training in '{self.folder}' are replaced.")
        elif refused:
            self.tell("There is no whole checkpoint: the training begins anew.")
        return None

    def remove(self) -> None:
        """Removes the files, and the folder if there is nothing else in it."""
        for path in (self._path(0), self._path(1)):
            path.unlink(missing_ok=True)
            part_of(path).unlink(missing_ok=True)
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _path(self, k: int) -> Path:
        return self.folder / f"checkpoint-{k % 2}.npz"


class ForeignCheckpointError(InvalidInputError):
    """A checkpoint belongs to another run."""


def _load(path: Path, run: Run, kind: type[Update]) -> SearchState:
    arrays = read_archive(path)
    content = json.loads(arrays.pop(_CONTENT).tobytes())
    _compare(content["run"], run.identity(), path)
    return from_entries(SearchState, content["state"], arrays, last=kind | None)


def _compare(found: dict[str, Any], wanted: dict[str, Any], path: Path) -> None:
    theirs, ours = differences(found, wanted)
    if theirs:
        names = ("format", "task", _CONTENT_OF_TASK)
        others = [name for name in names if found.get(name) != wanted[name]]
        since = "The task has changed since: " if others == [_CONTENT_OF_TASK] else ""
        raise ForeignCheckpointError(
            f"{since}'{path}' belongs to a training with {theirs}, but this one has {ours}; name "
            f"another folder, or remove '{path.parent}' to begin anew."
        )
