# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The whole graph at work: a training that never ends, a policy that drives, a recorder.

Real processes in one ROS domain. Faults strike it; what it published meanwhile is kept, to be
compared with what the bags hold and with what the same training gives undisturbed.
"""

import signal
import time
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import ResetSimulation, SetSimulationState

from tests.faults.listener import Listener
from tests.faults.records import Recording
from tests.faults.trainings import LEARNING, Trainings
from tests.nodes.conftest import Graph, Process

NODES = (
    "simulation",
    "trajectory_optimizer",
    "policy_executor",
    "policy_learner",
    "recorder",
    "visualizer",
)
NOTICED = 5.0  # until others say that a node is silent (docs/explanation/reliability.md) [s]
BACK = 60.0  # generous: the machine may be busy [s]
ENDING = (signal.SIGINT, signal.SIGTERM)  # what ends a node properly


class System:
    """The graph under test.

    Args:
        graph: its processes.
        task: what it learns.
        mode: of the simulation, lock_step or real_time.
        iterations: of each training.
        rng: of all that is random.

    Attributes:
        processes: the latest one of each node.
        recordings: the bags, the one that is being written last.
        strikes: when what fault struck [s].
        slowest: that all others needed to miss a silent node [s].
    """

    def __init__(self, graph: Graph, task: str, mode: str, *, iterations: int, rng: Random):
        self.graph = graph
        self.task = task
        self.mode = mode
        self.rng = rng
        self.processes: dict[str, Process] = {}
        self.recordings: list[Recording] = []
        self.strikes: list[tuple[float, str]] = []
        self.slowest = 0.0
        self.listener = Listener(graph.node)
        self.trainings = Trainings(graph, iterations, rng)
        for name in NODES:
            self.start(name)
        self.play()
        self.wait_until_it_works()

    def start(self, name: str, prefix: Sequence[str] = ()) -> None:
        """Starts a node, for the first time or again, as a prefix says; see `Graph.start`."""
        parameters: dict[str, Any] = {"task": self.task}
        self.listener.started(name)
        if name == "simulation":
            parameters["mode"] = self.mode
        elif name == "policy_learner":
            parameters |= {**LEARNING, "checkpoint_folder": self.graph.folder / "checkpoints"}
        elif name == "recorder":
            self.recordings.append(Recording(self.graph.folder / f"bag_{len(self.recordings)}"))
            self.listener.recording = self.recordings[-1]
            parameters = {"output": self.recordings[-1].path}
        elif name == "visualizer":
            parameters = {"output": self.graph.folder / f"run_{len(self.graph.processes)}.rrd"}
        self.processes[name] = self.graph.start(name, prefix=prefix, **parameters)

    def play(self) -> None:
        """Lets the simulation run, once it is there; a killed one seems to be for a while."""
        self.listener.forget_words()
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
        self.listener.killed(name)
        self.processes[name].kill()

    def end(self, name: str) -> None:
        """Ends a node with INT or TERM, once or twice."""
        if name == "recorder":
            self.recordings[-1].close(slack=0.5)  # what is on its way
            self.recordings[-1].ended = True
        if name == "policy_learner":
            self.trainings.may_end_early = True
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

    def wait_for_word(self, text: str, timeout: float = BACK, node: str = "") -> None:
        """Waits until some node, or this one, says this, or has since `forget_words`."""
        self.wait_for(
            lambda: any(node in name for name in self.listener.who_said(text)),
            f"'{text}' on /diagnostics",
            timeout,
        )

    def wait_until_missed(self, name: str) -> None:
        """Waits until all others say on /diagnostics that a node is silent, or have since.

        Raises:
            AssertionError: some do not, within what is promised and what it takes to say so.
        """
        others = {f"/{other}" for other in NODES} - {f"/{name}"}
        word, began = f"/{name} has been silent", time.monotonic()
        self._spin_until(lambda: not others - self.listener.who_said(word).keys(), NOTICED)
        said = self.listener.who_said(word)
        deaf = sorted(others - said.keys())
        heard = ", ".join(f"{who} after {when - began:.1f} s" for who, when in said.items())
        assert not deaf, (
            f"After {NOTICED:g} s not all said '{word}', but {heard or 'nobody'}: "
            f"{'; '.join(map(self.listener.words_of, deaf))}."
        )
        self.slowest = max(self.slowest, max(said.values()) - began)

    def wait_until_it_works(self) -> None:
        """Waits until every node is well and each stream flows."""
        self.listener.forget()
        assert self._spin_until(lambda: not self.listener.missing(NODES), BACK), (
            f"After {BACK:g} s: {' '.join(self.listener.missing(NODES))}"
        )

    def dead(self) -> list[str]:
        """Returns the nodes that have ended without being asked to."""
        return [name for name, process in self.processes.items() if not process.running]

    def _spin_until(self, condition: Callable[[], object], timeout: float) -> bool:
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self.trainings.keep_going()
            self._keep_moving()
            self.graph.spin_for(0.05)
        return True

    def _keep_moving(self) -> None:
        """Does what the simulation asks for once a policy that has just begun to learn, and took
        over in mid-motion, has thrown the robot out of all bounds."""
        status = self.listener.said.get("/simulation")
        if status is None or "reset it" not in status.message:
            return
        print(f"reset, as the simulation asks: {status.message}", flush=True)
        del self.listener.said["/simulation"]
        answer = self.graph.call_async(ResetSimulation, "simulation/reset_simulation")
        self.graph.spin_until(answer.done, BACK, "the reset")
        playing = SimulationState(state=SimulationState.STATE_PLAYING)
        request = SetSimulationState.Request(state=playing)
        self.graph.call_async(SetSimulationState, "simulation/set_simulation_state", request)

    def finish_training(self) -> None:
        """Waits for the end of the training that is under way."""
        self.trainings.finishing = True
        program = self.trainings.all[-1].program
        self.wait_for(lambda: not program.running, "the end of the last training", 300.0)
        assert program.wait() == 0, program.output
