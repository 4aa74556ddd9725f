# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Real node processes for tests, each test in a ROS domain of its own.

    def test_it_answers(graph):
        simulation = graph.start("simulation", task="swimmer")
        states = graph.messages(JointState, "joint_states")
        graph.spin_until(lambda: states)
        assert graph.call(StepSimulation, "simulation/step_simulation").result.error_message
        assert simulation.end(signal.SIGTERM) == 0

Processes that a test leaves running are ended with INT, and must then exit with code 0.
"""

import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import StepSimulation
from std_msgs.msg import String
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg

import vgps_ros.tasks
from tests.nodes.forked import ForkedCommand, prepare
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import (
    command_from_msg,
    nanoseconds,
    policy_to_msg,
    stamp_of,
    state_to_msg,
)
from vgps_ros.messages.names import MJCF
from vgps_ros.robot.executed_control import ExecutedPolicy
from vgps_ros.ros_runtime.qos import LATCHED, LATEST, STREAM
from vgps_ros.tasks import Task

prepare()

T = TypeVar("T")

EXECUTABLES = Path(__file__).parents[2] / "install" / "vgps_ros" / "lib" / "vgps_ros"
DOMAINS = range(101, 232)
ENDING = (signal.SIGINT, signal.SIGTERM)
# For tests of how a node ends; all nodes take both signals alike.
EACH_SIGNAL = pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM]
)
START_UP = 10.0  # longest time until a process heeds signals [s]
PATIENCE = 90.0  # generous: the machine may be busy [s]


def executed(policy: GaussianPolicy, inputs: Array) -> Array:
    """Returns the torques without noise of an executor, (n_u,), for inputs (n_o,)."""
    return ExecutedPolicy(policy).mean(inputs)


class Process:
    """A running executable, ended by its process id.

    A command of `vgps` goes on in a fork: see `forked`. With a word before it, such as "env", its
    installed executable is started.
    """

    def __init__(self, name: str, command: list[str], environment: dict[str, str], log: Path):
        self.name = name
        self._began = time.monotonic()
        self._log = log
        self._process: ForkedCommand | subprocess.Popen[bytes]
        executable = Path(command[0])
        with log.open("w") as file:
            if executable.parent == EXECUTABLES:
                words = [executable.name, *command[1:]]
                self._process = ForkedCommand(words, environment, log)
            else:
                self._process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    env=environment,
                )

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def output(self) -> str:
        return self._log.read_text(errors="replace")

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    @property
    def memory(self) -> float:
        """Resident memory [MB]."""
        pages = int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    def wait(self, timeout: float = PATIENCE) -> int:
        """Waits for the process to end by itself; returns its exit code."""
        return self._process.wait(timeout)

    def send(self, number: int) -> None:
        """Sends a signal; to a new process INT and TERM only once it heeds them."""
        while number in ENDING and self.running and not self._heeds_signals():
            if time.monotonic() > self._began + START_UP:
                break
            time.sleep(0.02)
        self._process.send_signal(number)

    def _heeds_signals(self) -> bool:
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        caught = next(int(line.split()[1], 16) for line in lines if line.startswith("SigCgt"))
        return bool(caught >> (signal.SIGTERM - 1) & 1)

    def end(self, number: int = signal.SIGINT, timeout: float = PATIENCE) -> int:
        """Sends a signal, waits for the end and returns the exit code."""
        if self.running:
            self.send(number)
        return self.wait(timeout)

    def kill(self) -> None:
        """Kills it with SIGKILL."""
        self._process.kill()
        self._process.wait()


class Graph:
    """Node processes in one ROS domain, and a node of the test's own among them."""

    def __init__(self, domain_id: int, folder: Path):
        self.domain_id = domain_id
        self.folder = folder
        self.processes: list[Process] = []
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain_id),
            "ROS_LOG_DIR": str(folder / "log"),
            "PYTHONUNBUFFERED": "1",
        }
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node("test", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._diagnostics: dict[str, DiagnosticStatus] = {}
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics", self._take_diagnostics, STREAM
        )

    # Processes

    def start(
        self, executable: str, *arguments: str, prefix: Sequence[str] = (), **parameters: Any
    ) -> Process:
        """Starts an executable, after the words of a prefix, such as "env".

        Keyword arguments become its ROS parameters ('.' written '__').
        """
        ros = [f"{name.replace('__', '.')}:={_yaml(value)}" for name, value in parameters.items()]
        ros_arguments = [word for assignment in ros for word in ("-p", assignment)]
        if ros_arguments:
            ros_arguments = ["--ros-args", *ros_arguments]
        command = [*prefix, str(EXECUTABLES / executable), *arguments, *ros_arguments]
        return self.start_command(executable, command)

    def start_command(self, name: str, command: list[str]) -> Process:
        """Starts any command, in the graph's domain."""
        log = self.folder / f"{len(self.processes)}_{name}.log"
        process = Process(name, command, self._environment, log)
        self.processes.append(process)
        return process

    def start_program(self, program: str, *arguments: str) -> Process:
        """Starts a program that waits for nodes, as long as a busy machine may need."""
        return self.start(program, *arguments, "--timeout", str(PATIENCE))

    def close(self) -> None:
        """Ends what still runs; a process that does not end well fails the test."""
        running = [process for process in self.processes if process.running]
        for process in running:
            process.send(signal.SIGINT)
        bad = []
        for process in running:
            try:
                code = process.wait()
            except subprocess.TimeoutExpired:
                process.kill()
                code = "killed, since INT did not end it"
            if code != 0:
                bad.append(f"{process.name}: exit code {code}\n{process.output}")
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)
        assert not bad, "\n".join(bad)

    # The test's own node

    def spin_until(
        self, condition: Callable[[], T], timeout: float = PATIENCE, what: str = "it"
    ) -> T:
        """Spins until the condition is true and returns its value."""
        end = time.monotonic() + timeout
        while not (result := condition()):
            if time.monotonic() > end:
                logs = "\n".join(f"--- {p.name}\n{p.output}" for p in self.processes)
                raise TimeoutError(f"Waited {timeout:g} s for {what}.\n{logs}")
            self._executor.spin_once(timeout_sec=0.05)
        return result

    def spin_for(self, duration: float) -> None:
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def spin_until_output(self, process: Process, text: str) -> None:
        self.spin_until(lambda: text in process.output, what=f"{process.name} to say '{text}'")

    def ends(self, process: Process, code: int = 0) -> None:
        """Spins until a process has ended by itself, with an exit code."""
        self.spin_until(lambda: not process.running, 2.0 * PATIENCE, f"the end of {process.name}")
        assert process.wait() == code, process.output

    def messages(self, kind: type, topic: str, qos: Any = STREAM) -> list[Any]:
        """Subscribes; the list that it returns grows while the test spins."""
        received: list[Any] = []
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def publisher(self, kind: type, topic: str, qos: Any = STREAM) -> Any:
        """Returns a publisher that some node already listens to."""
        publisher = self.node.create_publisher(kind, topic, qos)
        self.spin_until(publisher.get_subscription_count, what=f"a subscriber of {topic}")
        return publisher

    def describe(self, task: Task) -> None:
        """Publishes the robot of a task, as the simulation does."""
        message = String(data=task.mjcf)
        self.node.create_publisher(String, MJCF, LATEST).publish(message)

    def call_async(self, kind: type, name: str, request: Any = None) -> Any:
        """Calls a service once it is there and returns the response's future."""
        client = self.node.create_client(kind, name)
        self.spin_until(client.service_is_ready, what=f"the service {name}")
        self.spin_for(0.1)  # for the service to discover the client, too: it answers only once
        return client.call_async(request or kind.Request())

    def call(self, kind: type, name: str, request: Any = None, timeout: float = PATIENCE) -> Any:
        """Calls a service once it is there and returns its response."""
        future = self.call_async(kind, name, request)
        self.spin_until(future.done, timeout, what=f"the answer of {name}")
        return future.result()

    def step(self, steps: int) -> Any:
        """Lets a paused simulation do some steps; returns the outcome once they are done."""
        request = StepSimulation.Request(steps=steps)
        return self.call(StepSimulation, "simulation/step_simulation", request).result

    def change(self, transition: int) -> bool:
        """Asks the executor for a transition of its lifecycle; returns whether it did it."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, "policy_executor/change_state", request).success)

    def publish_policy(self, policy: GaussianPolicy, task: str = "swimmer") -> Any:
        """Publishes a policy, also for nodes that start later; returns the publisher."""
        publisher = self.node.create_publisher(GaussianPolicyMsg, "policy", LATCHED)
        publisher.publish(policy_to_msg(policy, task, 1, Time()))
        return publisher

    def record(self, **parameters: Any) -> Process:
        """Starts a recorder of the folder `bag`, and returns it once it records."""
        recorder = self.start("recorder", output=self.folder / "bag", **parameters)
        self.spin_until_output(recorder, "Recording to")
        return recorder

    def record_run(self, steps: int, task: str, *, to_its_end: bool = False, **given: Any) -> Path:
        """Lets an executor drive its simulation in lock-step, recorded; returns the bag's folder.

        The keyword arguments are parameters of the executor; with `to_its_end` the bag has its last
        command, too.
        """
        recorder = self.record()
        self.start("simulation", task=task, start_paused=True)
        patient = {"state_timeout": 60.0}  # the machine may be busy
        executor = self.start("policy_executor", task=task, **patient, **given)
        for topic, count in (("joint_states", 2), ("joint_command", 2), (MJCF, 1)):
            heard = partial(self.node.count_subscribers, topic)
            self.spin_until(lambda n=count, heard=heard: heard() == n, what=f"who hears {topic}")
        program = self.start_program("execute_policy", "--task", task, "--steps", str(steps))
        self.ends(program)
        if to_its_end:
            assert executor.end() == 0
            self.spin_for(0.5)  # until its last command is recorded
        assert recorder.end(signal.SIGINT) == 0, recorder.output
        return self.folder / "bag"

    def set_parameter(self, node: str, name: str, value: Any) -> SetParametersResult:
        parameter = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        return self.call(SetParameters, f"{node}/set_parameters", request).results[0]

    def diagnosis(
        self, node: str, level: bytes | None, text: str = "", timeout: float = PATIENCE
    ) -> DiagnosticStatus:
        """Waits for a new status of this level, or of any, whose message contains the text."""
        self._diagnostics.pop(f"/{node}", None)

        def found() -> DiagnosticStatus | None:
            status = self._diagnostics.get(f"/{node}")
            if status is None or level not in (status.level, None):
                return None
            return status if text in status.message else None

        return self.spin_until(found, timeout, f"the level {level!r} with '{text}' of {node}")

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        self._diagnostics.update({status.name: status for status in message.status})


class Hardware:
    """What a controller drives: it sends the states that a test says, and keeps the commands."""

    def __init__(self, graph: Graph, task: Task):
        self.graph, self.task = graph, task
        self.commands = graph.messages(JointState, "joint_command")
        self.states = graph.node.create_publisher(JointState, "joint_states", STREAM)

    def send(self, state: Any, stamp: int = 0) -> None:
        """Sends a state of a stamp [ns]."""
        names = self.task.joint_names
        self.states.publish(state_to_msg(np.array(state), names, stamp_of(stamp)))

    def message(self, state: Any, stamp: int = 0) -> JointState:
        """Sends a state, again each second as the simulation does, and returns what answers it."""
        self.commands.clear()
        due = 0.0

        def answers() -> list[JointState]:
            nonlocal due
            if time.monotonic() > due:
                due = time.monotonic() + 1.0
                self.send(state, stamp)
            return [c for c in self.commands if nanoseconds(c.header.stamp) == stamp]

        return self.graph.spin_until(answers, what=f"the answer to the state of {stamp} ns")[0]

    def answer(self, state: Any, stamp: int = 0) -> Array:
        """Sends a state and returns the controls that answer it, shape (n_u,)."""
        return command_from_msg(self.message(state, stamp), self.task.controls)


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """The figures beside a status, by their keys."""
    return {pair.key: pair.value for pair in status.values}


@contextmanager
def open_graph(folder: Path) -> Iterator[Graph]:
    with _free_domain() as domain_id:
        graph = Graph(domain_id, folder)
        try:
            yield graph
        finally:
            graph.close()


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    """A graph for one test."""
    with open_graph(tmp_path) as opened:
        yield opened


@pytest.fixture(scope="module")
def shared_graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """A graph that the tests of one file share, so that its nodes start once."""
    with open_graph(tmp_path_factory.mktemp("graph")) as opened:
        yield opened


@pytest.fixture(scope="session")
def random_policy(swimmer: Task) -> Callable[[int], GaussianPolicy]:
    """Returns a function that draws a policy for the swimmer, with torques of some N·m."""

    def draw(seed: int) -> GaussianPolicy:
        shape = Architecture(swimmer.observation.names, (5,), swimmer.dynamics.control_dim)
        parameters = 3.0 * np.random.default_rng(seed).standard_normal(shape.num_parameters)
        return GaussianPolicy(shape, parameters, np.array([2.0, 3.0]))

    return draw


TOLD = """
model: rotor.xml
control_period: 0.05
horizon: 2.5
start:
  std: {position: 0.1, velocity: 0.1}
commands:
  angle: {from: cmd_vel/angular/z, range: [-1.0, 1.0], unit: rad}
  lift: {range: [0.0, 0.5], unit: rad}
clock: {frequency: 2.0}
cost:
  - {sensor: rotor/position, target: {command: angle}}
  - {sensor: rotor/position, target: {command: lift}, weight: 0.1}
  - {sensor: rotor/velocity, target: {swing: 0.1}, weight: 0.1}
  - {control: all, weight: 1.0}
observe: [joint_positions, joint_velocities, commands, clock]
search: {renew: {share: 1.0, begin: 1, end: 0, worst: 1.0e+3}}
"""


@pytest.fixture
def told(tmp_path: Path) -> str:
    """The file of a task with commands and a clock: a rotor that is told its angle."""
    folder = tmp_path / "told"
    folder.mkdir()
    shutil.copy(Path(vgps_ros.tasks.__file__).parent / "rotor" / "rotor.xml", folder)
    (folder / "task.yaml").write_text(TOLD)
    return str(folder / "task.yaml")


def remember(file: Path, history: int) -> None:
    """Lets the policies of that task read their last action and former readings."""
    text = file.read_text().replace("velocities, commands", "velocities, last_action, commands")
    file.write_text(f"{text}history: {history}\n")


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A domain in which nobody is."""
    with _free_domain() as free:
        yield free


@contextmanager
def _free_domain() -> Iterator[int]:
    """Reserves a domain by an abstract socket: it vanishes with the process and is no file."""
    for domain_id in DOMAINS:
        with socket.socket(socket.AF_UNIX) as reservation:
            try:
                reservation.bind(f"\0vgps_ros_test_domain_{domain_id}")
            except OSError:
                continue
            yield domain_id
            return
    raise RuntimeError("All ROS domains from 101 to 231 are taken by other tests.")


def _yaml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
