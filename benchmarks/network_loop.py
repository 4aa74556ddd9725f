# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The control loop with a policy in an ONNX file beside the same policy in `policy.json`.

A file of ours becomes the policy that it was; a network of others runs in onnxruntime. The loops
stand in one graph, in a namespace each, and step in turns, so that whatever else the machine does
slows all.
"""

import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import StepSimulation

from benchmarks.graph import exported_file, network_file, policy_file
from benchmarks.processes import Bench, bench
from benchmarks.timing import Comparison
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import command_from_msg, nanoseconds
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.tasks import make_task

STEPS, PAIRS = 200, 60  # of a burst; bursts of each
LOOPS = ("exported", "network", "native")


def network_loop() -> Iterator[Comparison]:
    """The lock-step loop with a policy in an ONNX file against the same policy, native."""
    task = make_task("swimmer")
    with TemporaryDirectory() as folder, bench() as graph:
        write = (exported_file, network_file, policy_file)
        files = [write_one(task, Path(folder)) for write_one in write]
        torques: dict[str, dict[int, Array]] = {name: {} for name in LOOPS}
        for name, file in zip(LOOPS, files, strict=True):
            frames = [f"/{topic}:={topic}" for topic in ("clock", "tf", "tf_static")]
            own = [f"__ns:=/{name}", *frames]
            graph.start("simulation", *own, start_paused="true")
            graph.start("policy_executor", *own, policy_file=file)

            def take(message: JointState, into: dict[int, Array] = torques[name]) -> None:
                into[nanoseconds(message.header.stamp)] = command_from_msg(message, task.controls)

            graph.node.create_subscription(JointState, f"/{name}/joint_command", take, STREAM)
        for name in LOOPS:
            burst(graph, name)  # warm
        graph.spin_to(time.monotonic() + 1.0)
        common = sorted(set.intersection(*(set(torques[name]) for name in LOOPS)))
        found = {name: np.array([torques[name][t] for t in common]) for name in LOOPS}
        rates = np.array([[burst(graph, name) for name in LOOPS] for _ in range(PAIRS)])
    native = LOOPS.index("native")
    kinds = ("an exported policy", "a network of others in onnxruntime")
    for i, kind in enumerate(kinds):
        miss = np.abs(found[LOOPS[i]] - found["native"]).max() / np.abs(found["native"]).max()
        low, _, high = statistics.quantiles(rates[:, i] / rates[:, native], n=4)
        yield Comparison(
            f"lock-step loop: {kind} / the same policy, native",
            float(np.median(rates[:, i])),
            float(np.median(rates[:, native])),
            0.9,
            unit="loops/s",
            spread=0.5 * (high - low),
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
