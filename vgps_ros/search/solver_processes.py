# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Solves the situations of an iteration side by side, one process a core.

A solve is a pure function of its request, so where it runs changes no bit of it.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection, wait
from types import TracebackType

from vgps_ros.core.cores import count_cores
from vgps_ros.core.errors import VgpsError
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.trajectory_optimization import Outcome, attempt
from vgps_ros.simulation.dynamics import use_one_thread
from vgps_ros.tasks import Task

_PRELOADED = "vgps_ros.search.solver_processes"


class SolverProcesses:
    """Processes that solve requests; they start while whoever has made them goes on.

    Args:
        make_task: makes the task in each process; it must be one that pickle can name.
        count: how many processes; None for one a core.
    """

    def __init__(self, make_task: Callable[[], Task], count: int | None = None):
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([_PRELOADED])
        self.count = count or count_cores()
        end, self._end = context.Pipe(duplex=False)  # processes end once nobody holds its other end
        self._pool = ProcessPoolExecutor(self.count, context, _begin, (make_task, end))
        for _ in range(self.count):
            self._pool.submit(os.getpid)

    def __enter__(self) -> "SolverProcesses":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: object, trace: TracebackType | None
    ) -> None:
        if kind is not None:  # cancel running solves
            self._end.close()
        self._pool.shutdown(cancel_futures=True)

    def optimize_all(
        self,
        requests: Sequence[OptimizationRequest],
        on_progress: Callable[[float], None] = lambda _: None,
    ) -> list[Outcome]:
        """Solves several requests; their outcomes are in order.

        Args:
            requests: what to solve.
            on_progress: called at the end of each solve, with the share that is done.

        Raises:
            VgpsError: a process was ended from outside, as where memory is short.
        """
        try:
            solves = [self._pool.submit(_solve, request) for request in requests]
            for done, _ in enumerate(as_completed(solves), 1):
                on_progress(done / len(solves))
            return [solve.result() for solve in solves]
        except BrokenProcessPool as error:
            raise VgpsError(
                "A process that solves trajectories was ended from outside, perhaps since memory "
                "is short; the same command goes on after the last whole iteration."
            ) from error


_task: Task | None = None  # of this process


def _begin(make_task: Callable[[], Task], end: Connection) -> None:
    """Prepares a process, which ends when the one that has started it does, or wants it."""
    global _task  # noqa: PLW0603
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the other process ends this one
    threading.Thread(target=_exit_at, args=(end,), daemon=True).start()
    use_one_thread()
    _task = make_task()


def _exit_at(end: Connection) -> None:
    wait([end])
    os._exit(1)


def _solve(request: OptimizationRequest) -> Outcome:
    assert _task is not None
    return attempt(_task, request)
