# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A client of the simulation's services that waits for no answer."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.task import Future
from simulation_interfaces.msg import Result, SimulationState
from simulation_interfaces.srv import (
    GetSimulationState,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)

from vgps_ros.ros_runtime.qos import CALLS

_STATES = {
    SimulationState.STATE_STOPPED: "stopped",
    SimulationState.STATE_PLAYING: "playing",
    SimulationState.STATE_PAUSED: "paused",
    SimulationState.STATE_QUITTING: "quitting",
}


class SimulationClient:
    """Calls the services; a sentence tells what became of each call.

    Args:
        node: the node that calls.
        simulation: name of the simulation.
        tell: called with each sentence.

    Attributes:
        state: how the simulation ran when `look` asked last, in a word.
    """

    def __init__(self, node: Node, simulation: str, tell: Callable[[str], object]):
        self.state = ""
        self._tell, self._name = tell, simulation
        self._asked: Future | None = None

        def client(kind: Any, name: str) -> Any:
            return node.create_client(kind, f"{simulation}/{name}", qos_profile=CALLS)

        self._get = client(GetSimulationState, "get_simulation_state")
        self._set = client(SetSimulationState, "set_simulation_state")
        self._reset = client(ResetSimulation, "reset_simulation")
        self._step = client(StepSimulation, "step_simulation")

    def play(self) -> None:
        """Lets the simulation play."""
        self._set_state(SimulationState.STATE_PLAYING)

    def pause(self) -> None:
        """Pauses the simulation."""
        self._set_state(SimulationState.STATE_PAUSED)

    def step(self, steps: int) -> None:
        """Lets a paused simulation do some steps."""
        self._call(self._step, StepSimulation.Request(steps=steps), f"{steps} steps")

    def reset(self) -> None:
        """Puts the robot into its initial state, at time 0."""
        self._call(self._reset, ResetSimulation.Request(), "Reset")

    def look(self) -> None:
        """Asks how the simulation runs; `state` tells it once the answer has come."""
        if not self._get.service_is_ready():
            self.state, self._asked = "", None
        elif self._asked is None or self._asked.done():
            self._asked = self._get.call_async(GetSimulationState.Request())
            self._asked.add_done_callback(self._take_state)

    def _take_state(self, done: Future) -> None:
        self.state = _STATES.get(done.result().state.state, "")

    def _set_state(self, wanted: int) -> None:
        state = SimulationState(state=wanted)
        what = _STATES[wanted].capitalize()
        self._call(self._set, SetSimulationState.Request(state=state), what)

    def _call(self, client: Any, request: Any, what: str) -> None:
        if not client.service_is_ready():
            self._tell(f"There is no simulation named {self._name}: is it running?")
            return

        def answer(done: Future) -> None:
            result = done.result().result
            is_good = result.result == Result.RESULT_OK
            self._tell(f"{what}: done." if is_good else result.error_message)
            self.look()

        client.call_async(request).add_done_callback(answer)
