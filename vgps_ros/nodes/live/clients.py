# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Clients of the simulation's services and of controllers' parameters; they wait for no answer."""

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future
from simulation_interfaces.msg import Result, SimulationState
from simulation_interfaces.srv import (
    GetSimulationState,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.robot.signals import Command
from vgps_ros.ros_runtime.commands import FACTS, commands_of
from vgps_ros.ros_runtime.qos import CALLS

# Parameters of a planner, as the node `mpc` has them.
_READINGS, _TARGETS, _WEIGHTS = "cost.readings", "cost.targets", "cost.weights"
_STATES = {
    SimulationState.STATE_STOPPED: "stopped",
    SimulationState.STATE_PLAYING: "playing",
    SimulationState.STATE_PAUSED: "paused",
    SimulationState.STATE_QUITTING: "quitting",
}


class SimulationClient:
    """Calls the services; `tell` is called with what became of each call.

    Attributes:
        state: how the simulation ran when `look` asked last, in a word.
    """

    def __init__(self, node: Node, simulation: str, tell: Callable[[str], object]):
        self.state = ""
        self._tell, self._name = tell, simulation

        def client(kind: Any, name: str) -> Any:
            return node.create_client(kind, f"{simulation}/{name}", qos_profile=CALLS)

        self._get = client(GetSimulationState, "get_simulation_state")
        self._set = client(SetSimulationState, "set_simulation_state")
        self._reset = client(ResetSimulation, "reset_simulation")
        self._step = client(StepSimulation, "step_simulation")

    def set(self, wanted: int) -> None:
        """Lets the simulation play, or pauses it, by the number of the state."""
        request = SetSimulationState.Request(state=SimulationState(state=wanted))
        self._call(self._set, request, _STATES[wanted].capitalize())

    def step(self, steps: int) -> None:
        """Lets a paused simulation do some steps."""
        self._call(self._step, StepSimulation.Request(steps=steps), f"{steps} steps")

    def reset(self) -> None:
        """Puts the robot into its initial state, at time 0."""
        self._call(self._reset, ResetSimulation.Request(), "Reset")

    def look(self) -> None:
        """Asks how the simulation runs; `state` tells it once the answer has come."""
        if not self._get.service_is_ready():
            self.state = ""
            return

        def take(done: Future) -> None:
            self.state = _STATES.get(done.result().state.state, "")

        # Also where the last question has no answer: it may have been lost.
        self._get.call_async(GetSimulationState.Request()).add_done_callback(take)

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


def _ask(client: AsyncParameterClient, names: Sequence[str], then: Callable[..., object]) -> None:
    """Calls back with the values of a node's parameters, or with none where it lacks one."""

    def take(done: Future) -> None:
        values = [parameter_value_to_python(value) for value in done.result().values]
        then(values if None not in values else [])

    client.get_parameters(list(names)).add_done_callback(take)


class CostClient:
    """Reads and sets the targets and weights of a planner's cost, which are its parameters.

    `show` is called with the readings, their targets and their weights; `tell` with a sentence on
    each change.
    """

    def __init__(
        self,
        planner: AsyncParameterClient,
        show: Callable[..., object],
        tell: Callable[[str], object],
    ):
        self._client, self._show, self._tell = planner, show, tell
        self._changing = 0  # changes whose answer is awaited

    def look(self) -> None:
        """Asks for the values; nothing is shown while there is no planner or no such cost."""
        if not self._client.services_are_ready():
            self._show((), (), ())
        else:
            _ask(self._client, (_READINGS, _TARGETS, _WEIGHTS), self._take)

    def set(self, targets: Sequence[float], weights: Sequence[float]) -> None:
        """Sets all values at once."""
        values = {_TARGETS: list(map(float, targets)), _WEIGHTS: list(map(float, weights))}
        parameters = [Parameter(name, value=value) for name, value in values.items()]

        def answer(done: Future) -> None:
            self._changing -= 1
            result = done.result().result
            self._tell("The next plan has the new cost." if result.successful else result.reason)

        self._changing += 1
        self._client.set_parameters_atomically(parameters).add_done_callback(answer)

    def _take(self, values: list[Any]) -> None:
        if self._changing == 0:  # else the visitor's values are newer
            self._show(*values or ((), (), ()))


class CommandsClient:
    """Asks the first controller that is there which commands it takes.

    `show` is called with them, and with none where there is no controller or it takes none; `tell`
    with a sentence on what it cannot have meant.
    """

    def __init__(
        self,
        controllers: Sequence[AsyncParameterClient],
        show: Callable[[Sequence[Command]], object],
        tell: Callable[[str], object],
    ):
        self._controllers, self._show, self._tell = controllers, show, tell

    def look(self) -> None:
        """Asks again."""
        for client in self._controllers:
            if client.services_are_ready():
                _ask(client, list(FACTS), self._take)
                return
        self._show(())

    def _take(self, facts: list[Any]) -> None:
        try:
            self._show(commands_of(facts) if facts else ())
        except InvalidInputError as error:
            self._show(())
            self._tell(str(error))
