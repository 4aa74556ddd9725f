# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmarks of the graph: what its processes and its middleware cost, and its deadlines."""

import statistics
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import StepSimulation
from vgps_msgs.srv import OptimizeTrajectory

from benchmarks.problems import initial_request
from benchmarks.processes import Bench, bench, processor_seconds, resident_memory
from benchmarks.timing import Comparison, compare
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import command_from_msg, nanoseconds, stamp_of, state_to_msg
from vgps_ros.messages.optimization import request_to_msg
from vgps_ros.policies.onnx_file import ExportedPolicy, parse_model, to_onnx
from vgps_ros.programs.export import metadata
from vgps_ros.ros_runtime.qos import NEWEST, STREAM
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.storage.run_folder import load_policy, save_policy
from vgps_ros.tasks import Task, make_task

LOOPS = 3000  # of each lock-step run
ROUNDS = 5  # runs of each
IDLE_SECONDS = 15.0
RESTING = 0.05  # share of a core, below which a node has done what it does at its start
SOLVES = 101
SOLVE_ITERATIONS = 10
RATES = (100, 500)  # of control [Hz]
SECONDS = 60.0  # for which deadlines are watched
_ALL = QoSProfile(depth=10_000)  # nothing that this process reads late may be missing
BURST, BURSTS = 200, 60  # steps of a burst; bursts of each kind of policy
KINDS = ("exported", "network", "native")
NODES = ("simulation", "policy_executor", "trajectory_optimizer", "policy_learner", "recorder")


def lock_step() -> Iterator[Comparison]:
    """The control loop through two processes against a bare ping-pong of the same messages."""
    task = make_task("swimmer")
    with TemporaryDirectory() as folder:
        policy = policy_file(task, Path(folder))
        pongs, answers, loops, together, works = [], [], [], [], []
        for _ in range(ROUNDS):
            with bench() as graph:
                pid = graph.start_module("benchmarks.pong")
                graph.spin_until(lambda: graph.node.count_publishers("joint_command"), "a start")
                before = processor_seconds(pid)
                pongs.append(_round_trips(graph, task))
                works.append(processor_seconds(pid) - before)
            with bench() as graph:
                pid = graph.start("policy_executor", policy_file=policy)
                graph.spin_until(lambda: graph.node.count_publishers("joint_command"), "a start")
                before = processor_seconds(pid)
                answers.append(_round_trips(graph, task))
                works.append(processor_seconds(pid) - before)
            with bench() as graph:
                graph.start("simulation", start_paused="true")
                graph.start("policy_executor", policy_file=policy)
                _loop_rate(graph, LOOPS // 10)
                loops.append(_loop_rate(graph, LOOPS))
            with bench() as graph:
                told: dict[str, Any] = {"simulation:start_paused": "true"}
                told["policy_executor:policy_file"] = policy
                graph.start("node", nodes=("simulation", "policy_executor"), **told)
                _loop_rate(graph, LOOPS // 10)
                together.append(_loop_rate(graph, LOOPS))
    pong_rate = statistics.median(1.0 / statistics.fmean(run) for run in pongs)
    yield Comparison(
        "lock-step loop: simulation and executor / bare ping-pong",
        statistics.median(loops),
        pong_rate,
        0.7,
        unit="loops/s",
    )
    yield Comparison(
        "lock-step loop: simulation and executor in one process / in two",
        statistics.median(together),
        statistics.median(loops),
        2.0,
        unit="loops/s",
    )
    for name, share in (("median", 0.5), ("p99", 0.99)):
        ours, peer = (
            1e3 * statistics.median(float(np.quantile(run, share)) for run in runs)
            for runs in (answers, pongs)
        )
        yield Comparison(f"executor's answer, {name} / bare ping-pong's", ours, peer, 1.5)
    own, bare = (1e3 * statistics.median(works[i::2]) / LOOPS for i in (1, 0))
    yield Comparison("processor time an answer, executor / bare ping-pong", own, bare, 2.0)


def policy_file(task: Task, folder: Path) -> Path:
    """Writes a policy with small torques; returns its path."""
    shape = Architecture(task.observation.names, (5,), task.dynamics.control_dim)
    rng = np.random.default_rng(0)
    parameters = 0.1 * rng.standard_normal(shape.num_parameters)
    policy = GaussianPolicy(shape, parameters, np.ones(task.dynamics.control_dim))
    save_policy(policy, task.name, folder / "policy.json")
    return folder / "policy.json"


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


def _loop_rate(graph: Bench, steps: int, namespace: str = "") -> float:
    """Returns the rate of steps that simulation and executor do together [1/s]."""
    began = time.perf_counter()
    name, request = f"{namespace}simulation/step_simulation", StepSimulation.Request(steps=steps)
    answer = graph.call(StepSimulation, name, request)
    if answer.result.error_message:
        raise RuntimeError(answer.result.error_message)
    return steps / (time.perf_counter() - began)


def network_loop() -> Iterator[Comparison]:
    """The lock-step loop with a policy in an ONNX file against the same policy, native."""
    # A file of ours becomes the policy that it was; a network of others runs in onnxruntime. The
    # loops stand in one graph and step in turns, so that whatever else the machine does slows all.
    task = make_task("swimmer")
    with TemporaryDirectory() as folder, bench() as graph:
        write = (_exported_file, _network_file, policy_file)
        files = [write_one(task, Path(folder)) for write_one in write]
        torques: dict[str, dict[int, Array]] = {name: {} for name in KINDS}
        for name, file in zip(KINDS, files, strict=True):
            frames = [f"/{topic}:={topic}" for topic in ("clock", "tf", "tf_static")]
            own = [f"__ns:=/{name}", *frames]
            graph.start("simulation", *own, start_paused="true")
            graph.start("policy_executor", *own, policy_file=file)

            def take(message: JointState, into: dict[int, Array] = torques[name]) -> None:
                into[nanoseconds(message.header.stamp)] = command_from_msg(message, task.controls)

            graph.node.create_subscription(JointState, f"/{name}/joint_command", take, STREAM)
        for name in KINDS:
            _loop_rate(graph, BURST, f"/{name}/")  # warm
        graph.spin_to(time.monotonic() + 1.0)
        common = sorted(set.intersection(*(set(torques[name]) for name in KINDS)))
        found = {name: np.array([torques[name][t] for t in common]) for name in KINDS}
        rates = np.array(
            [[_loop_rate(graph, BURST, f"/{name}/") for name in KINDS] for _ in range(BURSTS)]
        )
    native = KINDS.index("native")
    kinds = ("an exported policy", "a network of others in onnxruntime")
    for i, kind in enumerate(kinds):
        miss = np.abs(found[KINDS[i]] - found["native"]).max() / np.abs(found["native"]).max()
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


def _exported_file(task: Task, folder: Path) -> Path:
    """Writes the same policy as an ONNX file."""
    policy, _ = load_policy(policy_file(task, folder))
    exported = ExportedPolicy(policy, task.dynamics.control_limits, "float32")
    path = folder / "policy.onnx"
    path.write_bytes(to_onnx(exported, metadata(task, policy, folder)))
    return path


def _network_file(task: Task, folder: Path) -> Path:
    """Writes the same policy as a network of others, which onnxruntime executes."""
    model = parse_model(_exported_file(task, folder).read_bytes(), "The policy")
    model.graph.name = "network of others"
    path = folder / "network.onnx"
    path.write_bytes(model.SerializeToString())
    return path


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
    ours, peers = [], []
    with TemporaryDirectory() as folder:
        policy = policy_file(task, Path(folder))
        for i in range(1 + ROUNDS):
            own = _parameters(policy, f"{folder}/bag{i}")
            with bench() as graph:
                began = time.perf_counter()
                for name in NODES:
                    graph.start(name, **own.get(name, {}))
                ours.append(_first_command(graph) - began)
            with bench() as graph:
                began = time.perf_counter()
                graph.start("simulation")
                graph.start_module("benchmarks.pong")
                peers.append(_first_command(graph) - began)
        pairs = zip(ours[1:], peers[1:], strict=True)  # the first start keeps what Python compiles
        low, _, high = statistics.quantiles([ours / peer for ours, peer in pairs], n=4)
        yield Comparison(
            "start of all nodes to the first command / of simulation and a bare node",
            1e3 * statistics.median(ours[1:]),
            1e3 * statistics.median(peers[1:]),
            2.0,
            spread=0.5 * (high - low),
        )
        own = _parameters(policy, f"{folder}/bag")
        for name in NODES:
            with bench() as graph:
                spent = _start_seconds(graph, graph.start(name, **own.get(name, {})), name)
            yield Comparison(
                f"{name}: processor time of its start / a second", 1e3 * spent, 1e3, 1.0
            )


def _parameters(policy: Path, bag: str) -> dict[str, dict[str, Any]]:
    """Returns the parameters of the nodes that need some at their start."""
    return {"policy_executor": {"policy_file": policy}, "recorder": {"output": bag}}


def _start_seconds(graph: Bench, pid: int, name: str) -> float:
    """Returns the processor time until a node is in the graph and rests [s]."""
    graph.spin_until(lambda: name in graph.node.get_node_names(), name)
    before, spent = 0.0, processor_seconds(pid)
    while spent - before > RESTING:
        time.sleep(1.0)
        before, spent = spent, processor_seconds(pid)
    return before


def _first_command(graph: Bench) -> float:
    """Waits for a command; returns when it came [s]."""
    times: list[float] = []
    graph.node.create_subscription(
        JointState, "joint_command", lambda _: times.append(time.perf_counter()), _ALL
    )
    graph.spin_until(lambda: times, "a command")
    return times[0]
