# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmarks of the graph: what its processes and its middleware cost."""

import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import StepSimulation
from vgps_msgs.srv import OptimizeTrajectory

from benchmarks.problems import initial_request
from benchmarks.processes import Bench, bench, processor_seconds, resident_memory
from benchmarks.timing import Comparison, compare
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import nanoseconds, stamp_of, state_to_msg
from vgps_ros.messages.optimization import request_to_msg
from vgps_ros.policies.onnx_file import ExportedPolicy, parsed, to_onnx
from vgps_ros.programs.export import metadata
from vgps_ros.ros_runtime.qos import NEWEST, STREAM
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.storage.run_folder import load_policy, save_policy
from vgps_ros.tasks import Task, make_task

LOOPS = 3000  # of each lock-step run
ROUNDS = 5  # runs of each
IDLE_SECONDS = 15.0
SOLVES = 101
SOLVE_ITERATIONS = 10
NODES = ("simulation", "policy_executor", "trajectory_optimizer", "policy_learner", "recorder")


def lock_step() -> Iterator[Comparison]:
    """The control loop through two processes against a bare ping-pong of the same messages."""
    task = make_task("swimmer")
    with TemporaryDirectory() as folder:
        policy = policy_file(task, Path(folder))
        pongs, answers, loops = [], [], []
        for _ in range(ROUNDS):
            with bench() as graph:
                graph.start_module("benchmarks.pong")
                pongs.append(_round_trips(graph, task))
            with bench() as graph:
                graph.start("policy_executor", policy_file=policy)
                answers.append(_round_trips(graph, task))
            with bench() as graph:
                graph.start("simulation", start_paused="true")
                graph.start("policy_executor", policy_file=policy)
                loops.append(_loop_rate(graph))
    pong_rate = statistics.median(1.0 / statistics.fmean(run) for run in pongs)
    yield Comparison(
        "lock-step loop: simulation and executor / bare ping-pong",
        statistics.median(loops),
        pong_rate,
        0.7,
        unit="loops/s",
    )
    for name, share in (("median", 0.5), ("p99", 0.99)):
        ours, peer = (
            1e3 * statistics.median(float(np.quantile(run, share)) for run in runs)
            for runs in (answers, pongs)
        )
        yield Comparison(f"executor's answer, {name} / bare ping-pong's", ours, peer, 1.5)


def policy_file(task: Task, folder: Path) -> Path:
    """Writes a policy with small torques; returns its path."""
    shape = Architecture(task.observation.names, (5,), task.dynamics.control_dim)
    rng = np.random.default_rng(0)
    parameters = 0.1 * rng.standard_normal(shape.num_parameters)
    policy = GaussianPolicy(shape, parameters, np.ones(task.dynamics.control_dim))
    save_policy(policy, task.name, folder / "policy.json")
    return folder / "policy.json"


def exported_file(task: Task, folder: Path) -> Path:
    """Writes the same policy as an ONNX file."""
    policy, _ = load_policy(policy_file(task, folder))
    exported = ExportedPolicy(policy, task.dynamics.control_limits, "float32")
    path = folder / "policy.onnx"
    path.write_bytes(to_onnx(exported, metadata(task, policy, folder)))
    return path


def network_file(task: Task, folder: Path) -> Path:
    """Writes the same policy as a network of others, which onnxruntime executes."""
    model = parsed(exported_file(task, folder).read_bytes(), "The policy")
    model.graph.name = "network of others"
    path = folder / "network.onnx"
    path.write_bytes(model.SerializeToString())
    return path


def _round_trips(graph: Bench, task: Task) -> list[float]:
    """Returns the times from a state to the command with its stamp [s]."""
    node = graph.node
    publisher = node.create_publisher(JointState, "joint_states", STREAM)
    begun = answered = 0.0
    step, stamp = 0, 0
    durations: list[float] = []

    def send() -> None:
        nonlocal begun, step, stamp
        step += 1
        stamp = round(1e9 * step * task.dynamics.time_step)
        state = np.full(task.dims["n_x"], 1e-3)
        efforts = np.zeros(task.dynamics.model.nv)
        begun = time.perf_counter()
        publisher.publish(state_to_msg(state, task.joint_names, stamp_of(stamp), efforts))

    def take(command: JointState) -> None:
        nonlocal answered
        if nanoseconds(command.header.stamp) != stamp:
            return
        answered = time.perf_counter()
        durations.append(answered - begun)
        if len(durations) < LOOPS:
            send()

    node.create_subscription(JointState, "joint_command", take, NEWEST)
    graph.spin_until(publisher.get_subscription_count, "a controller")

    def first_answer() -> bool:  # the controller may hear before it is heard
        if not durations and time.perf_counter() - begun > 0.5:
            send()
        return bool(durations)

    graph.spin_until(first_answer, "an answer")
    graph.spin_until(lambda: len(durations) >= LOOPS, "all answers")
    return durations[LOOPS // 10 :]


def _loop_rate(graph: Bench) -> float:
    """Returns the steps that simulation and executor do together [1/s]."""

    def run(steps: int) -> float:
        began = time.perf_counter()
        name = "simulation/step_simulation"
        answer = graph.call(StepSimulation, name, StepSimulation.Request(steps=steps))
        if answer.result.error_message:
            raise RuntimeError(answer.result.error_message)
        return time.perf_counter() - began

    run(LOOPS // 10)
    return LOOPS / run(LOOPS)


def service() -> Iterator[Comparison]:
    """A solve through the optimizer's service against the same solve in process."""
    task = make_task("swimmer")
    request = initial_request(task, SOLVE_ITERATIONS)
    message = request_to_msg(request, task, stamp_of(0))
    with bench() as graph:
        graph.start("trajectory_optimizer")

        def through_the_graph() -> None:
            answer = graph.call(OptimizeTrajectory, "trajectory_optimizer/optimize", message)
            if not answer.success:
                raise RuntimeError(answer.message)

        yield compare(
            f"{SOLVE_ITERATIONS} DDP iterations through the service / in process",
            through_the_graph,
            lambda: optimize(task, request),
            1.05,
            repetitions=SOLVES,
        )


def nodes() -> Iterator[Comparison]:
    """Each node while nothing happens: its share of a core, its memory beside a bare node's."""
    with bench() as graph:
        bare = graph.start_module("benchmarks.pong")
        graph.spin_until(lambda: "pong" in graph.node.get_node_names(), "a bare node")
        bare_memory = resident_memory(bare)
    with bench() as graph, TemporaryDirectory() as folder:
        own = {"simulation": {"start_paused": "true"}, "recorder": {"output": f"{folder}/bag"}}
        pids = {name: graph.start(name, **own.get(name, {})) for name in NODES}
        graph.spin_until(lambda: set(NODES) <= set(graph.node.get_node_names()), "all nodes")
        time.sleep(5.0)  # for what they do at their start
        before = {name: processor_seconds(pid) for name, pid in pids.items()}
        time.sleep(IDLE_SECONDS)
        for name, pid in pids.items():
            yield Comparison(
                f"{name}: idle / a whole core",
                100 * (processor_seconds(pid) - before[name]) / IDLE_SECONDS,
                100.0,
                0.03,
                unit="%",
            )
        for name, pid in pids.items():
            yield Comparison(
                f"{name}: memory / a bare node's",
                resident_memory(pid),
                bare_memory,
                None,
                unit="MB",
            )
