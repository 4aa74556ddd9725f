# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Solves on the workers of a Dask cluster: the bits of one process, and workers that are lost."""

import os
import signal
import threading
from functools import partial

import dask
import pytest
from distributed import LocalCluster

from tests.search.test_checkpoints import bits
from tests.told_rotor import maker, write_task
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.settings import with_values
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.search import cluster as cluster_module
from vgps_ros.search import solver_processes
from vgps_ros.search.cluster import Cluster
from vgps_ros.search.methods import search
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.settings import search_settings
from vgps_ros.search.solver_processes import SolverProcesses
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.tasks import make_task
from vgps_ros.tasks.task import task_digest

VALUES = {"iterations": 3, "situations": 4, "initial_ddp_iterations": 5, "renew.share": 0.6}
VALUES |= {"renew.begin": 2, "renew.end": 1, "renew.seconds": 1.0, "keep.rollouts": 6}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_task(tmp_path_factory.mktemp("told"))


@pytest.fixture(scope="module")
def task(path):
    return make_task(path)


@pytest.fixture
def local_cluster(tmp_path):
    """Starts clusters of processes of this machine, on loopback alone."""
    started = []

    def start(workers):
        own = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
        started.append(LocalCluster(n_workers=workers, host="127.0.0.1", **own))
        return started[-1]

    with dask.config.set({"temporary_directory": str(tmp_path)}):
        yield start
        for each in started:
            each.close()


def run(task, solve):
    return list(search("vgps", task, with_values(search_settings(task), VALUES), 6, solve))


def test_a_worker_that_is_killed_costs_no_bit(path, task, local_cluster):
    workers = local_cluster(2).workers
    pids = [worker.pid for worker in workers.values()]
    asked = []

    def solve(requests):
        asked.append(len(requests))
        if len(asked) == 2:  # while the first iteration's solves wait
            threading.Timer(0.05, os.kill, (pids[0], signal.SIGKILL)).start()
        return solvers.optimize_all(requests)

    address = next(iter(workers.values())).scheduler_addr
    with SolverProcesses(
        maker(path), executor=Cluster(address), digest=task_digest(task)
    ) as solvers:
        found = run(task, solve)
    assert bits(found[-1]) == bits(run(task, partial(optimize_all, task))[-1])
    assert len(asked) >= 4
    assert pids[0] not in [worker.pid for worker in workers.values()]


@pytest.mark.slow
def test_training_by_the_command_line_leaves_the_same_files(path, local_cluster, tmp_path):
    words = ["train", "--task", path, "--iterations", "1", "--situations", "2"]
    address = local_cluster(2).scheduler_address
    for name, more in (("here", ()), ("there", ("--cluster", address))):
        vgps([*words, *more, "--output", str(tmp_path / name)])
    for file in ("policy.json", "distribution.npz", "trajectories.npz"):
        one, other = ((tmp_path / name / file).read_bytes() for name in ("here", "there"))
        assert one == other


def ask(path, cluster, make=None, **options):
    """Solves once on a cluster."""
    request = first_request(make_task(path), 0, 1)
    with SolverProcesses(
        make or maker(path), executor=Cluster(cluster.scheduler_address), **options
    ) as solvers:
        return solvers.optimize_all([request])


def test_without_any_worker_it_ends_with_a_sentence(path, local_cluster, monkeypatch):
    monkeypatch.setattr(cluster_module, "_PATIENCE", 2)
    with pytest.raises(VgpsError, match=r"has lost .* all of its workers; .*`dask worker ADD"):
        ask(path, local_cluster(0))


def test_a_scheduler_that_ends_leaves_a_sentence(path, local_cluster):
    cluster, request = local_cluster(0), first_request(make_task(path), 0, 1)
    there = Cluster(cluster.scheduler_address)
    threading.Timer(2.0, cluster.close).start()
    with (
        pytest.raises(VgpsError, match="has lost its scheduler"),
        SolverProcesses(maker(path), executor=there) as solvers,
    ):
        solvers.optimize_all([request])


@pytest.mark.slow
def test_a_solve_that_kills_its_workers_ends_with_a_sentence(path, local_cluster):
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        cluster = local_cluster(1)
    with pytest.raises(VgpsError, match="has lost several workers by one solve"):
        ask(path, cluster, partial(os._exit, 1))


def test_workers_that_would_find_other_bits_are_refused(path, local_cluster, monkeypatch):
    cluster = local_cluster(1)
    with pytest.raises(InvalidInputError, match=r"has task \w+, .* has task 0{12};"):
        ask(path, cluster, digest="0" * 12)
    monkeypatch.setattr(solver_processes, "versions", lambda: {"numpy": "1.0.0"})
    with pytest.raises(InvalidInputError, match=r"A worker on .* has numpy 2.* has numpy 1\.0\.0;"):
        ask(path, cluster)


@pytest.mark.parametrize("address", ["nonsense", "http://127.0.0.1:8786", "127.0.0.1:1"])
def test_an_address_that_does_not_answer_says_what_to_start(address, monkeypatch):
    monkeypatch.setattr(cluster_module, "_ANSWER", 1.0)
    with pytest.raises(InvalidInputError, match=r"No Dask scheduler answers at .* `dask scheduler"):
        Cluster(address)


def test_one_situation_needs_no_cluster(path, tmp_path):
    words = ["train", "--task", path, "--cluster", "127.0.0.1:1", "--output", str(tmp_path / "run")]
    with pytest.raises(SystemExit, match="A single situation is solved here"):
        vgps(words)
