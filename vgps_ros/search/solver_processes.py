# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Solves the situations of an iteration side by side, one process a core, or on a cluster.

A solve is a pure function of its request, so where it runs changes no bit of it.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache, partial
from multiprocessing.connection import Connection
from socket import gethostname
from typing import Any

from vgps_ros.core.cores import count_cores
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.settings import differences
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.trajectory_optimization import Outcome, attempt
from vgps_ros.simulation.dynamics import use_one_thread
from vgps_ros.storage.software import versions
from vgps_ros.tasks import Task
from vgps_ros.tasks.task import task_digest

_PRELOADED = "vgps_ros.search.solver_processes"


class SolverProcesses:
    """Processes that solve requests; they start while whoever has made them goes on.

    Args:
        make_task: makes the task in each process; pickle can name it and its hashable arguments.
        count: how many processes; None for one a core.
        executor: processes elsewhere, in place of those of this machine.
        digest: the task's, which that of each process must have; empty: it is not compared.
    """

    def __init__(
        self,
        make_task: "partial[Task]",
        count: int | None = None,
        executor: Executor | None = None,
        digest: str = "",
    ):
        wanted = versions() | ({"task": digest} if digest else {})
        self._source = tuple(wanted.items()), make_task.func, *make_task.args
        count = count or count_cores()
        self._executor = executor or _LocalProcesses(count)
        for _ in range(0 if executor else count):
            self._executor.submit(_prepare, *self._source)

    def __enter__(self) -> "SolverProcesses":
        return self

    def __exit__(self, *error: Any) -> None:
        self._executor.__exit__(*error)

    def optimize_all(
        self,
        requests: Sequence[OptimizationRequest],
        on_progress: Callable[[float], None] = lambda _: None,
    ) -> list[Outcome]:
        """Solves several requests, in order; each one that ends shows the share that is done.

        Raises:
            VgpsError: a process was ended from outside, has other software, or makes another task.
        """
        try:
            solves = [self._executor.submit(_solve, each, *self._source) for each in requests]
            for done, solve in enumerate(as_completed(solves), 1):
                solve.result()
                on_progress(done / len(solves))
            return [solve.result() for solve in solves]
        except BrokenProcessPool as error:
            raise VgpsError(
                "A process that solves trajectories was ended from outside, perhaps since memory "
                "is short; the same command goes on after the last whole iteration."
            ) from error


class _LocalProcesses(ProcessPoolExecutor):
    """Processes of this machine, which end when this one does."""

    def __init__(self, count: int):
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([_PRELOADED])
        end, self._end = context.Pipe(duplex=False)  # processes end once nobody holds its other end
        super().__init__(count, context, _begin, (end,))

    def __exit__(self, kind: Any, *_: object) -> None:
        if kind is not None:  # cancel running solves
            self._end.close()
        self.shutdown(cancel_futures=True)


def _begin(end: Connection) -> None:
    """Prepares a process, which ends when the one that has started it does, or wants it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the other process ends this one
    # Nothing is ever sent, so this waits until the pipe is closed.
    threading.Thread(target=lambda: os._exit(end.poll(None)), daemon=True).start()


def _prepare(*source: Any) -> None:
    """Makes the task of this process before its first solve."""
    _make_task(*source)


_solving = threading.Lock()  # a worker of a cluster may have several threads, but has one task


def _solve(request: OptimizationRequest, *source: Any) -> Outcome:
    with _solving:
        return attempt(_make_task(*source), request)


@lru_cache(maxsize=1)
def _make_task(wanted: tuple[tuple[str, str], ...], make: Callable[..., Task], *given: Any) -> Task:
    """Makes the task of this process, once; raises if it would find other bits than are wanted."""
    use_one_thread()
    multiprocessing.current_process().daemon = False  # a task's model is tried in a child
    task = make(*given)
    theirs, ours = differences({**versions(), "task": task_digest(task)}, dict(wanted))
    if theirs:
        raise InvalidInputError(
            f"A worker on {gethostname()} has {theirs}, but this training has {ours}; install the "
            "same there, and copy the task's files, since other ones find other bits."
        )
    return task
