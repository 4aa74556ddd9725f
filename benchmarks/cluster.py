# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a cluster is worth: measured with a few workers, and simulated with many.

`python -m benchmarks.cluster` measures a solve, what it sends, what the scheduler takes for it, and
what an iteration does besides, in time of the processor, since others may use the machine. From
these it simulates iterations of more situations and workers.
"""

import heapq
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.reduction import ForkingPickler

import numpy as np
from distributed import LocalCluster

from benchmarks.problems import SEED
from benchmarks.timing import Comparison, compare
from vgps_ros.core.records import Array
from vgps_ros.search.cluster import Cluster
from vgps_ros.search.methods import search
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.settings import search_settings
from vgps_ros.search.solver_processes import SolverProcesses
from vgps_ros.search.trajectory_optimization import Outcome, attempt
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.tasks import make_task

TASK = "quadruped"
FEW, MANY = (1, 2, 4), tuple(2**n for n in range(9))  # workers
SITUATIONS = (24, 100, 1000)  # simulated
MEASURED = (24, 72)  # situations, for what grows with them
ITERATIONS, TASKS = 3, 200


@contextmanager
def local_cluster(workers: int) -> Iterator[Cluster]:
    """Gives a cluster of processes of this machine, on loopback alone."""
    options = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(n_workers=workers, **options) as cluster:
        yield Cluster(cluster.scheduler_address)


def cluster_workers() -> Iterator[Comparison]:
    """The solves of an iteration of the quadruped's 24 situations: a cluster against a process."""
    task = make_task(TASK)
    requests = _measured(MEASURED[0], 1).requests
    make = partial(make_task, TASK)
    with SolverProcesses(make, 1) as one:
        for count in FEW:
            with local_cluster(count) as executor, SolverProcesses(make, None, executor) as there:
                yield compare(
                    f"{task.name}: solves of {len(requests)} situations, {count} workers of a "
                    "cluster / one process",
                    partial(there.optimize_all, requests),
                    partial(one.optimize_all, requests),
                    None,
                    repetitions=5,
                )


@dataclass(frozen=True)
class Measured:
    """An iteration in this process: its solves [s], their messages [bytes], and the rest [s]."""

    requests: Sequence[OptimizationRequest]
    times: Array
    sent: float
    returned: float
    rest: float


def _measured(situations: int, iterations: int = ITERATIONS) -> Measured:
    task, solves = make_task(TASK), list[tuple[OptimizationRequest, int, Outcome, float]]()

    def solve(requests: Sequence[OptimizationRequest]) -> list[Outcome]:
        solves.clear()
        for request in requests:
            size, began = len(ForkingPickler.dumps(request)), time.process_time()
            outcome = attempt(task, request)
            solves.append((request, size, outcome, time.process_time() - began))
        return [outcome for *_, outcome, _ in solves]

    settings = replace(search_settings(task), iterations=iterations + 1, situations=situations)
    ends = [0.0]
    for iteration in search("vgps", task, settings, SEED, solve):
        ends.append(time.process_time())
        if iteration.k == iterations:  # the last one of a search also chooses a policy
            break
    times = np.array([seconds for *_, seconds in solves])
    returned = [len(ForkingPickler.dumps(outcome)) for *_, outcome, _ in solves]
    return Measured(
        [request for request, *_ in solves],
        times,
        float(np.mean([size for _, size, *_ in solves])),
        float(np.mean(returned)),
        ends[-1] - ends[-2] - times.sum(),
    )


def _answer(_: Array, count: int) -> Array:
    return np.zeros(count)


def _task_seconds(executor: Cluster, sent: float, returned: float) -> float:
    """Returns what a task that computes nothing takes, of many at once [s]."""
    message, count = np.random.default_rng(SEED).random(int(sent) // 8), int(returned) // 8
    executor.submit(_answer, message, count).result()
    began = time.process_time()
    answers = [executor.submit(_answer, message, count) for _ in range(TASKS)]
    for answer in as_completed(answers):
        answer.result()
    return (time.process_time() - began) / TASKS


def simulate(times: Sequence[float], workers: int, per_task: float) -> float:
    """Returns how long solves take [s], each by the worker that is free first.

    The scheduler hands out one after another, and takes `per_task` for each [s].
    """
    free, sent = [0.0] * workers, 0.0
    for seconds in times:
        sent += per_task
        heapq.heappush(free, max(heapq.heappop(free), sent) + seconds)
    return max(free)


def main(say: Callable[[str], None] = print) -> None:
    """Measures, simulates and prints the table."""
    silence_mujoco()
    few, more = (_measured(count) for count in MEASURED)
    growth = (more.rest - few.rest) / (MEASURED[1] - MEASURED[0])
    with local_cluster(2) as executor, executor:
        empty, full = (
            _task_seconds(executor, *sizes) for sizes in ((0, 0), (few.sent, few.returned))
        )
    say(
        f"A solve takes {np.min(more.times):.3f} to {np.max(more.times):.3f} s, in the mean "
        f"{np.mean(more.times):.3f} s; its request has {few.sent / 1e6:.2f} MB, its result "
        f"{few.returned / 1e6:.2f} MB. A task takes {1e3 * empty:.1f} ms empty, {1e3 * full:.1f} "
        f"ms with them. The rest of an iteration takes {few.rest:.1f} and {more.rest:.1f} s at "
        f"{MEASURED[0]} and {MEASURED[1]} situations."
    )
    say("| workers | " + " | ".join(f"{n:,} situations" for n in SITUATIONS) + " |")
    say("| --- " * (len(SITUATIONS) + 1) + "|")
    for workers in MANY:
        cells = []
        for count in SITUATIONS:
            times = np.random.default_rng(SEED).choice(more.times, count)
            solves = simulate(list(times), workers, full)
            rest = few.rest + growth * (count - MEASURED[0])
            cells.append(
                f"{solves:.1f} + {rest:.1f} s, {(times.sum() + rest) / (solves + rest):.1f} ×"
            )
        say(f"| {workers} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
