# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Time of an iteration's solves against the number of optimizer nodes, on one host and on two.

The hosts are network namespaces that a pair of virtual interfaces joins, with a shared memory of
their own. This module, run by itself in the first one, makes the second one and measures.
"""

import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rclpy.action import ActionClient
from vgps_msgs.action import TrainPolicy
from vgps_msgs.msg import LearningProgress

from benchmarks.problems import SEED
from benchmarks.processes import Bench, bench
from benchmarks.timing import Comparison
from vgps_ros.ros_runtime.qos import STREAM

INITIAL_STATES = 8
_ITERATIONS = 8  # of each training; the first is not counted
_HERE: Sequence[str] = ()  # words before a command that start it on the first host
_NEW_HOST = ("unshare", "--user", "--map-root-user", "--net", "--mount")


def optimizers() -> Iterator[Comparison]:
    """The solves of an iteration, of eight initial states, shared by one and by two optimizers."""
    one = _solve_seconds([_HERE])
    yield _growth("optimizers of one host", one, _solve_seconds([_HERE, _HERE]))
    run = subprocess.run(
        [*_NEW_HOST, sys.executable, "-m", "benchmarks.optimizers"],
        env={**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": ""},  # on a network of its own
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode:
        raise RuntimeError(f"Two hosts could not be made or measured: {run.stderr}")
    yield _growth("optimizers of two hosts", one, float(run.stdout.splitlines()[-1]))


def _growth(name: str, one: float, two: float) -> Comparison:
    return Comparison(
        f"swimmer, {name}: exponent of {INITIAL_STATES} solves' time / ideal",
        math.log2(two / one),
        -1.0,
        None,
        unit="",
        curve=((1, one), (2, two)),
    )


def _solve_seconds(hosts: Sequence[Sequence[str]]) -> float:
    """Returns the median time of an iteration's solves with an optimizer on each host [s]."""
    names = [f"optimizer_{i}" for i in range(len(hosts))]
    with bench() as graph:
        for name, host in zip(names, hosts, strict=True):
            graph.start("trajectory_optimizer", f"__node:={name}", host=host)
        graph.start(
            "policy_learner",
            optimizers=f"[{', '.join(names)}]",
            situations=INITIAL_STATES,
            initial_ddp_iterations=2,
            evaluation_rollouts=1,
        )
        graph.spin_until(lambda: set(names) <= set(graph.node.get_node_names()), "the optimizers")
        return statistics.median(_train(graph)[1:])


def _train(graph: Bench) -> list[float]:
    """Returns the time of each iteration's solves [s]."""
    durations: list[float] = []

    def take(progress: Any) -> None:
        durations.append(progress.q_step_seconds)

    graph.node.create_subscription(LearningProgress, "learning_progress", take, STREAM)
    client: Any = ActionClient(graph.node, TrainPolicy, "policy_learner/train")
    graph.spin_until(client.server_is_ready, "the learner")
    client.send_goal_async(TrainPolicy.Goal(seed=SEED, iterations=[_ITERATIONS], hidden_units=[5]))
    graph.spin_until(lambda: len(durations) >= _ITERATIONS, "the training", patience=300.0)
    client.destroy()
    return durations


@contextmanager
def _second_host() -> Iterator[Sequence[str]]:
    """Makes a second host; gives the words that start a process there."""
    other = subprocess.Popen(["unshare", "--net", "--mount", "sleep", "1000"])
    there = ("nsenter", "--target", str(other.pid), "--net", "--mount")
    try:
        while os.readlink(f"/proc/{other.pid}/ns/net") == os.readlink("/proc/self/ns/net"):
            time.sleep(0.02)
        _run(*there, "mount", "-t", "tmpfs", "none", "/dev/shm")
        _run("ip", "link", "add", "here", "type", "veth", "peer", "name", "there", "netns",
             str(other.pid))  # fmt: skip
        ends = (("here", _HERE), ("there", there))
        for number, (name, words) in enumerate(ends, start=1):
            _run(*words, "ip", "address", "add", f"10.77.0.{number}/24", "dev", name)
            _run(*words, "ip", "link", "set", "lo", "up")
            _run(*words, "ip", "link", "set", name, "up")
        while not all(
            "state UP" in _run(*words, "ip", "link", "show", name) for name, words in ends
        ):
            time.sleep(0.02)
        yield there
    finally:
        other.kill()
        other.wait()


def _run(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    with _second_host() as there:
        print(_solve_seconds([_HERE, there]))
