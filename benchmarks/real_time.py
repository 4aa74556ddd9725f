# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmarks of the graph in real time: deadlines, and how soon the robot moves."""

import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from benchmarks.graph import NODES, policy_file
from benchmarks.processes import Bench, bench
from benchmarks.timing import Comparison
from vgps_ros.messages.conversions import nanoseconds
from vgps_ros.tasks import make_task

RATES = (100, 500)  # of control [Hz]
SECONDS = 60.0  # for which deadlines are watched
_ALL = QoSProfile(depth=10_000)  # nothing that this process reads late may be missing


def real_time() -> Iterator[Comparison]:
    """Commands that come later than the next state, at 100 and 500 Hz, over a minute each."""
    task = make_task("swimmer")
    with TemporaryDirectory() as folder:
        policy = policy_file(task, Path(folder))
        for rate in RATES:
            with bench() as graph:
                factor = rate * task.dynamics.time_step
                graph.start("policy_executor", policy_file=policy)
                graph.start("simulation", mode="real_time", real_time_factor=factor)
                missed, states = _missed(graph)
            yield Comparison(
                f"real time, {rate} Hz, {SECONDS:g} s: missed deadlines / all",
                missed,
                states,
                None,
                unit="",
            )


def _missed(graph: Bench) -> tuple[int, int]:
    """Returns the states whose command was published after the next state, and all states."""
    published: dict[str, dict[int, int]] = {"joint_states": {}, "joint_command": {}}

    def take(topic: str) -> Callable[[JointState, dict[str, int]], None]:
        times = published[topic]

        def note(message: JointState, info: dict[str, int]) -> None:
            times.setdefault(nanoseconds(message.header.stamp), info["source_timestamp"])

        return note

    for topic in published:
        # rclpy's types do not know that a callback may take the message's times too.
        callback: Any = take(topic)
        graph.node.create_subscription(JointState, topic, callback, _ALL)
    states, commands = published.values()
    graph.spin_until(lambda: len(commands) > 100, "commands")  # what a start costs does not count
    first, end = max(states), time.monotonic() + SECONDS
    graph.spin_until(lambda: time.monotonic() > end, "the end", 2 * SECONDS)
    stamps = sorted(stamp for stamp in states if stamp >= first)[:-2]  # the last may be under way
    late = [
        stamp not in commands or commands[stamp] > states[following]
        for stamp, following in pairwise(stamps)
    ]
    return sum(late), len(late)


def start() -> Iterator[Comparison]:
    """From the start of all nodes to the first command, against a bare node's first answer."""
    task = make_task("swimmer")
    with TemporaryDirectory() as folder:
        policy = policy_file(task, Path(folder))
        with bench() as graph:
            own: dict[str, dict[str, Any]] = {
                "policy_executor": {"policy_file": policy},
                "recorder": {"output": f"{folder}/bag"},
            }
            began = time.perf_counter()
            for name in NODES:
                graph.start(name, **own.get(name, {}))
            ours = _first_command(graph) - began
        with bench() as graph:
            began = time.perf_counter()
            graph.start("simulation")
            graph.start_module("benchmarks.pong")
            peer = _first_command(graph) - began
    yield Comparison(
        "start of all nodes to the first command / of simulation and a bare node",
        1e3 * ours,
        1e3 * peer,
        None,
    )


def _first_command(graph: Bench) -> float:
    """Waits for a command; returns when it came [s]."""
    times: list[float] = []
    graph.node.create_subscription(
        JointState, "joint_command", lambda _: times.append(time.perf_counter()), _ALL
    )
    graph.spin_until(lambda: times, "a command")
    return times[0]
