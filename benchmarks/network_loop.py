# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The control loop with a policy in onnxruntime beside the same policy executed by this project.

Both loops stand in one graph, in a namespace each, and step in turns, so that whatever else the
machine does slows both.
"""

import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import StepSimulation

from benchmarks.graph import network_file, policy_file
from benchmarks.processes import Bench, bench
from benchmarks.timing import Comparison
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import command_from_msg, nanoseconds
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.tasks import make_task

STEPS, PAIRS = 200, 60  # of a burst; bursts of each
LOOPS = ("network", "ours")


def network_loop() -> Iterator[Comparison]:
    """The lock-step loop with the policy in onnxruntime against the same policy, ours."""
    task = make_task("swimmer")
    with TemporaryDirectory() as folder, bench() as graph:
        files = (network_file(task, Path(folder)), policy_file(task, Path(folder)))
        torques: dict[str, dict[int, Array]] = {name: {} for name in LOOPS}
        for name, file in zip(LOOPS, files, strict=True):
            frames = [f"/{topic}:={topic}" for topic in ("clock", "tf", "tf_static")]
            own = [f"__ns:=/{name}", *frames]
            graph.start("simulation", *own, start_paused="true")
            graph.start("policy_executor", *own, policy_file=file)

            def take(message: JointState, into: dict[int, Array] = torques[name]) -> None:
                into[nanoseconds(message.header.stamp)] = command_from_msg(
                    message, task.actuated_joint_names
                )

            graph.node.create_subscription(JointState, f"/{name}/joint_command", take, STREAM)
        for name in LOOPS:
            burst(graph, name)  # warm
        graph.spin_to(time.monotonic() + 1.0)
        common = sorted(set(torques[LOOPS[0]]) & set(torques[LOOPS[1]]))
        theirs, mine = (np.array([torques[name][t] for t in common]) for name in LOOPS)
        miss = float(np.abs(theirs - mine).max() / np.abs(mine).max())
        pairs = [tuple(burst(graph, name) for name in LOOPS) for _ in range(PAIRS)]
    network, ours = (statistics.median(rates) for rates in zip(*pairs, strict=True))
    ratios = statistics.quantiles([pair[0] / pair[1] for pair in pairs], n=4)
    yield Comparison(
        "lock-step loop: policy in onnxruntime / the same policy, ours",
        network,
        ours,
        0.9,
        unit="loops/s",
        spread=0.5 * (ratios[2] - ratios[0]),
        remark=f"torques of {len(common)} steps differ by at most {miss:.0e} of the largest",
    )


def burst(graph: Bench, name: str) -> float:
    """Does some steps of one loop; returns their rate [1/s]."""
    began = time.perf_counter()
    request = StepSimulation.Request(steps=STEPS)
    answer = graph.call(StepSimulation, f"/{name}/simulation/step_simulation", request)
    if answer.result.error_message:
        raise RuntimeError(answer.result.error_message)
    return STEPS / (time.perf_counter() - began)
