"""The whole graph at work: a training that never ends, a policy that drives, a recorder.

Real processes in one ROS domain. Faults strike it; what it published meanwhile is kept, to be
compared with what the bags hold and with what the same training gives undisturbed.
"""

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState
from vgps_msgs.msg import LearningProgress, OptimizerIteration, SimulationState
from vgps_msgs.srv import ResetSimulation, SetSimulationState

from tests.nodes.conftest import Graph, Process
from vgps_ros.nodes.qos import NEWEST, SIGNS_OF_LIFE, STREAM

NODES = (
    "simulation",
    "trajectory_optimizer",
    "policy_executor",
    "policy_learner",
    "recorder",
    "visualizer",
)
NOTICED = 5.0  # in which the others say that a node is silent, as docs/reliability.md promises [s]
BACK = 60.0  # generous: the machine may be busy [s]
KEPT = {  # what must be in the bags, by who publishes it
    "policy_learner": "/learning_progress",
    "trajectory_optimizer": "/trajectory_optimizer/iterations",
}
STARTED = 0.5  # before that a node has not even read its program: what comes is another's [s]
FOUND = 1.0  # in which all others have found a node after the first one [s]
RESENT = 3.0  # after which a publisher sends again what a busy reader has missed, at most [s]
ENDING = (signal.SIGINT, signal.SIGTERM)  # what ends a node properly
LEARNING = {"initial_ddp_iterations": 10, "evaluation_rollouts": 2}
HIDDEN_UNITS = 4


@dataclass
class Recording:
    """A bag, and the times between which all that was published must be in it [s]."""

    path: Path
    windows: list[list[float]] = field(default_factory=list)  # begin and end of each
    killed: bool = False
    ended: bool = False

    @property
    def is_open(self) -> bool:
        return bool(self.windows) and self.windows[-1][1] == float("inf")

    def close(self, slack: float) -> None:
        """Ends the window: what came within the last `slack` seconds may be missing [s]."""
        if self.is_open:
            self.windows[-1][1] = time.monotonic() - slack

    def covers(self, moment: float) -> bool:
        return any(begin < moment < end for begin, end in self.windows)


@dataclass
class Training:
    """A training of the graph: its seed, its folder and the program that asked for it."""

    seed: int
    folder: Path
    program: Process


@dataclass
class Published:
    """A message that the graph published, as CDR, and when it came [s]."""

    time: float
    topic: str
    data: bytes


@dataclass
class System:
    """The graph under test.

    Attributes:
        graph: its processes.
        task: what it learns.
        mode: of the simulation, lock_step or real_time.
        iterations: of each training.
        rng: of all that is random.
    """

    graph: Graph
    task: str
    mode: str
    iterations: int
    rng: Random
    processes: dict[str, Process] = field(default_factory=dict)
    recordings: list[Recording] = field(default_factory=list)
    trainings: list[Training] = field(default_factory=list)
    published: list[Published] = field(default_factory=list)
    strikes: list[tuple[float, str]] = field(default_factory=list)  # when, and with what
    said: dict[str, DiagnosticStatus] = field(default_factory=dict)
    words: list[tuple[float, str, str]] = field(default_factory=list)  # when who said what
    heard: dict[str, float] = field(default_factory=dict)  # when something came from each source

    def __post_init__(self) -> None:
        self.finishing = False
        self.slowest = 0.0  # that all others needed to miss a node [s]
        self.last_words: list[tuple[str, float]] = []  # topics of nodes that were killed, and when
        self.found: list[tuple[str, float]] = []  # topics of new nodes, and when they were heard
        self._begun: dict[str, float] = {}  # when those were started that were not heard yet
        self.learner_ended = False  # by a signal, which cancels what it trains
        self._subscribe(LearningProgress, KEPT["policy_learner"], STREAM, keep=True)
        self._subscribe(OptimizerIteration, KEPT["trajectory_optimizer"], STREAM, keep=True)
        self._subscribe(JointState, "/joint_states", NEWEST)
        self._subscribe(JointState, "/joint_command", NEWEST)
        self.graph.node.create_subscription(
            DiagnosticArray, "/diagnostics", self._listen, SIGNS_OF_LIFE
        )
        for name in NODES:
            self.start(name)
        self.play()
        self.wait_until_it_works()

    def start(self, name: str) -> None:
        """Starts a node, for the first time or again."""
        parameters: dict[str, Any] = {"task": self.task}
        if name in KEPT:
            self._begun[name] = time.monotonic()
        if name == "simulation":
            parameters["mode"] = self.mode
        elif name == "policy_learner":
            parameters |= {**LEARNING, "checkpoint_folder": self.graph.folder / "checkpoints"}
        elif name == "recorder":
            self.recordings.append(Recording(self.graph.folder / f"bag_{len(self.recordings)}"))
            parameters = {"output": self.recordings[-1].path}
        elif name == "visualizer":
            parameters = {"output": self.graph.folder / f"run_{len(self.graph.processes)}.rrd"}
        self.processes[name] = self.graph.start(name, **parameters)

    def play(self) -> None:
        """Lets the simulation run, once it is there; a killed one seems to be for a while."""
        self.listen()
        self.wait_for_word("", BACK, node="simulation")
        playing = SimulationState(state=SimulationState.STATE_PLAYING)
        request = SetSimulationState.Request(state=playing)
        name = "simulation/set_simulation_state"
        for _ in range(5):
            answer = self.graph.call_async(SetSimulationState, name, request)
            if self._spin_until(answer.done, BACK / 5):
                return
        raise AssertionError(f"{name} has not answered.")

    def kill(self, name: str) -> None:
        """Kills a node with SIGKILL."""
        if name == "recorder":
            self.recordings[-1].close(slack=1.0)
            self.recordings[-1].killed = self.recordings[-1].ended = True
        elif name in KEPT:
            self.last_words.append((KEPT[name], time.monotonic()))
        self.processes[name].kill()

    def end(self, name: str) -> None:
        """Ends a node with INT or TERM, once or twice."""
        if name == "recorder":
            self.recordings[-1].close(slack=0.5)  # what is on its way
            self.recordings[-1].ended = True
        if name == "policy_learner":
            self.learner_ended = True
        process = self.processes[name]
        if self.rng.random() < 0.5:
            process.send(self.rng.choice(ENDING))
            self.spin(self.rng.uniform(0.0, 0.5))
        assert process.end(self.rng.choice(ENDING)) == 0, process.output

    # What goes on

    def spin(self, duration: float) -> None:
        """Lets the graph work."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._spin_until(lambda: False, min(0.5, max(0.0, end - time.monotonic())))

    def wait_for(self, condition: Callable[[], object], what: str, timeout: float = BACK) -> None:
        """Lets it work until the condition holds.

        Raises:
            AssertionError: it does not in time.
        """
        assert self._spin_until(condition, timeout), f"Waited {timeout:g} s for {what}."

    def listen(self) -> None:
        """Forgets what nodes have said so far."""
        self.words.clear()

    def wait_for_word(self, text: str, timeout: float = BACK, node: str = "") -> None:
        """Waits until some node, or this one, says this on /diagnostics, or has since `listen`."""
        self.wait_for(
            lambda: any(node in name for name in self.who_said(text)),
            f"'{text}' on /diagnostics",
            timeout,
        )

    def wait_until_missed(self, name: str) -> None:
        """Waits until all others say on /diagnostics that a node is silent, or have since `listen`.

        Raises:
            AssertionError: some do not, within what is promised and what it takes to say so.
        """
        others = {f"/{other}" for other in NODES} - {f"/{name}"}
        word, began = f"/{name} has been silent", time.monotonic()
        self._spin_until(lambda: not others - self.who_said(word).keys(), NOTICED)
        said = self.who_said(word)
        deaf = others - said.keys()
        heard = "; ".join(f"{who} after {when - began:.1f} s" for who, when in said.items())
        last = "; ".join(
            f"{time.monotonic() - when:.1f} s ago {who}: {words}"
            for when, who, words in self.words
            if who in deaf
        )
        assert not deaf, (
            f"After {NOTICED:g} s {', '.join(deaf)} did not say: '{word}', but {last}. "
            f"Others did: {heard}."
        )
        self.slowest = max(self.slowest, max(said.values()) - began)

    def who_said(self, text: str) -> dict[str, float]:
        """Returns the nodes that have said this on /diagnostics since `listen`, and when first."""
        said: dict[str, float] = {}
        for when, name, word in self.words:
            if text in word:
                said.setdefault(name, when)
        return said

    def wait_until_it_works(self) -> None:
        """Waits until every node is well and each stream flows."""
        self.heard.clear()
        self.said.clear()
        assert self._spin_until(lambda: not self._missing(), BACK), (
            f"After {BACK:g} s: {' '.join(self._missing())}"
        )

    def _missing(self) -> list[str]:
        """Returns sentences on what does not work."""
        silent = {"/joint_states", "/joint_command"} - self.heard.keys()
        if not {"/learning_progress", "/trajectory_optimizer/iterations"} & self.heard.keys():
            silent.add("/learning_progress")
        missing = [f"Nothing comes on {topic}." for topic in sorted(silent)]
        for name in NODES:
            status = self.said.get(f"/{name}")
            if status is None or not _is_well(status):
                missing.append(f"/{name}: {status.message if status else 'nothing'}")
        return missing

    def expects(self, message: Published, recording: Recording) -> bool:
        """Returns whether a bag must hold a message.

        A killed node's last words may be lost: they may have reached this process, and been taken
        only after the kill; or the recorder may have missed them at first, and nobody was left to
        send them again. So may a new node's first words: it may have found this process before the
        recorder, and a stream keeps nothing for those who come later.
        """
        last = any(
            topic == message.topic and -1.0 < moment - message.time < 1.0 + RESENT
            for topic, moment in self.last_words
        )
        first = any(
            topic == message.topic and abs(message.time - moment) < FOUND
            for topic, moment in self.found
        )
        return recording.covers(message.time) and not (last or first)

    def dead(self) -> list[str]:
        """Returns the nodes that have ended without being asked to."""
        return [name for name, process in self.processes.items() if not process.running]

    def _spin_until(self, condition: Callable[[], object], timeout: float) -> bool:
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self._keep_training()
            self._keep_moving()
            self.graph.spin_for(0.05)
        return True

    def _keep_moving(self) -> None:
        """Does what the simulation asks for once a policy that has just begun to learn, and took
        over in mid-motion, has thrown the robot out of all bounds."""
        status = self.said.get("/simulation")
        if status is None or "reset it" not in status.message:
            return
        print(f"reset, as the simulation asks: {status.message}", flush=True)
        del self.said["/simulation"]
        answer = self.graph.call_async(ResetSimulation, "simulation/reset_simulation")
        self.graph.spin_until(answer.done, BACK, "the reset")
        playing = SimulationState(state=SimulationState.STATE_PLAYING)
        request = SetSimulationState.Request(state=playing)
        self.graph.call_async(SetSimulationState, "simulation/set_simulation_state", request)

    def _keep_training(self) -> None:
        if self.finishing or (self.trainings and self.trainings[-1].program.running):
            return
        if self.trainings and self.trainings[-1].program.wait():
            last = self.trainings[-1]
            assert self.learner_ended, last.program.output  # else nothing may end a training early
            last.program = self._ask_for_training(last.seed, last.folder)
            return
        self.learner_ended = False
        seed = self.rng.randrange(10**6)
        folder = self.graph.folder / f"training_{len(self.trainings)}"
        self.trainings.append(Training(seed, folder, self._ask_for_training(seed, folder)))

    def _ask_for_training(self, seed: int, folder: Path) -> Process:
        return self.graph.start(
            "train_through_graph",
            *("--iterations", str(self.iterations), "--seed", str(seed)),
            *("--hidden-units", str(HIDDEN_UNITS), "--output", str(folder)),
            *("--timeout", "60"),
        )

    def finish_training(self) -> None:
        """Waits for the end of the training that is under way."""
        self.finishing = True
        program = self.trainings[-1].program
        self.wait_for(lambda: not program.running, "the end of the last training", 300.0)
        assert program.wait() == 0, program.output

    # What is heard

    def _subscribe(self, kind: type, topic: str, qos: Any, *, keep: bool = False) -> None:
        def take(message: Any) -> None:
            self.heard[topic] = time.monotonic()
            if keep:
                self.published.append(Published(time.monotonic(), topic, message))

        self.graph.node.create_subscription(kind, topic, take, qos, raw=keep)

    def _listen(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name, now = status.name.lstrip("/"), time.monotonic()
            if now - self._begun.get(name, now) > STARTED:
                self.found.append((KEPT[name], now))
                del self._begun[name]
            self.said[status.name] = status
            self.words.append((now, status.name, status.message))
            if status.name == "/recorder" and status.level == DiagnosticStatus.OK:
                self._follow_recorder({value.key: value.value for value in status.values})

    def _follow_recorder(self, values: dict[str, str]) -> None:
        there = {
            name
            for name, _ in self.graph.node.get_topic_names_and_types()
            if "/_" not in name and self.graph.node.count_publishers(name)
        }
        recording = self.recordings[-1]
        new = not (recording.is_open or recording.ended)
        if new and int(values.get("topics", 0)) >= len(there):
            recording.windows.append([time.monotonic(), float("inf")])


def _is_well(status: DiagnosticStatus) -> bool:
    """A node may warn, as of a fit that gains nothing, but it must not miss another one."""
    warns = status.level == DiagnosticStatus.WARN and "silent" not in status.message
    return warns or status.level == DiagnosticStatus.OK
