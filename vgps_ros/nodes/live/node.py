# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `live`: a page for the browser that shows the graph's robot in motion and lets one touch it.

Its buttons call the services of `simulation`, a body that is dragged is pushed by messages on
`push`, its stick commands the controller by messages on `command`, and its sliders set parameters
of `mpc`. It listens on 127.0.0.1 alone.
"""

import time
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from std_msgs.msg import String
from vgps_msgs.msg import LearningProgress
from vgps_msgs.msg import Signals as SignalsMsg

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.settings import Range
from vgps_ros.messages.conversions import (
    nanoseconds,
    progress_from_msg,
    push_to_msg,
    signals_from_msg,
    signals_to_msg,
)
from vgps_ros.messages.names import COMMAND, CONTEXT, MJCF, driver
from vgps_ros.messages.robot_state import JOINTS, StateMessages
from vgps_ros.nodes.live.clients import CommandsClient, CostClient, SimulationClient
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare_settings
from vgps_ros.ros_runtime.qos import LATCHED, NEWEST, STATES, STREAM
from vgps_ros.ros_runtime.runner import Runnable
from vgps_ros.ros_runtime.services import steady_timer
from vgps_ros.search.metrics import IterationMetrics
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import compile_model


@dataclass(frozen=True)
class _LiveSettings:
    """Settings of the page. Their descriptions are what users read."""

    port: Annotated[
        int,
        Range(1024, 65000),
        "TCP port of the page, on 127.0.0.1; where it is taken, one of the next is used",
    ] = 8080
    simulation: Annotated[str, "name of the node whose services are called"] = "simulation"
    executor: Annotated[str, "name of the node that the stick commands"] = "policy_executor"
    planner: Annotated[
        str,
        "name of the node whose cost the sliders change, and that the stick commands where there "
        "is no executor",
    ] = "mpc"


_FRAME, _LOOK = 1 / 30, 0.5  # periods of the picture and of what is asked for [s]
_SILENCE = 3.0  # after which a controller that says nothing is no longer shown [s]
_LONGEST = 10_000  # iterations of a training that are drawn


class Live(Node):
    """Shows on the page what the graph says, and does what the page's visitor wants."""

    def __init__(self) -> None:
        super().__init__("live")
        settings = declare_settings(self, _LiveSettings())
        executor, planner = (
            AsyncParameterClient(self, name) for name in (settings.executor, settings.planner)
        )
        self._health = Health(self)
        self._health.wait_for(f"{MJCF} from simulation")
        self._states: StateMessages | None = None
        self._newest: dict[str, Any] | None = None  # messages of a state that is not shown yet
        self._time = ""  # of the robot
        self._drivers: dict[str, tuple[float, str]] = {}  # by controller, and when it said so
        self._history: dict[int, IterationMetrics] = {}
        self._is_drawn = True  # whether the history is
        self.simulation = SimulationClient(self, settings.simulation, self._tell)
        try:
            from vgps_ros.nodes.live.page import LivePage
        except ModuleNotFoundError as error:
            raise VgpsError(
                f"The page needs the package {error.name}: pip install -r requirements/live.txt."
            ) from error
        self.page = LivePage(settings.port, self)
        self.cost = CostClient(planner, self.page.show_cost, self._tell)
        self._commands = CommandsClient((executor, planner), self.page.show_commands, self._tell)
        self._told = self.create_publisher(SignalsMsg, COMMAND, STATES)
        self._pushes = self.create_publisher(WrenchStamped, "push", STATES)
        subscribe = self.create_subscription
        subscribe(String, MJCF, self._take_robot, LATCHED)
        subscribe(SignalsMsg, CONTEXT, self._take_context, NEWEST)
        subscribe(DiagnosticArray, "/diagnostics", self._take_diagnostics, STREAM)
        subscribe(LearningProgress, "learning_progress", self._take_progress, STREAM)
        steady_timer(self, _FRAME, self._show)
        steady_timer(self, _LOOK, self._look)
        self.get_logger().info(f"The page is {self.page.address}")

    def _show(self) -> None:
        """Shows the newest state, and does what the visitor wants."""
        if self._newest and self._states:
            messages, self._newest = self._newest, None
            with self._health.judging("state", "Left out a state"):
                self.page.show_state(self._states.join(messages))
                self._time = f"{nanoseconds(messages[JOINTS].header.stamp) * 1e-9:.2f} s"
        try:
            while self.page.wishes:
                self.page.wishes.popleft()()
            if push := self.page.push():
                self._pushes.publish(push_to_msg(*push))
            if commands := self.page.commands():
                now = self.get_clock().now().to_msg()
                self._told.publish(signals_to_msg(np.array([*commands.values()]), [*commands], now))
        except Exception as error:  # a page may send any value in a number's place
            self._tell(f"This cannot be: {error}")

    def _look(self) -> None:
        self.simulation.look()
        self.cost.look()
        self._commands.look()
        now = time.monotonic()
        said = [
            f"{name}: {sentence}"
            for name, (heard, sentence) in sorted(self._drivers.items())
            if now - heard < _SILENCE
        ]
        state = self.simulation.state or "There is no simulation."
        drives = "\n".join(said) or "No controller is there."
        self.page.tell(run=f"{state} {self._time}", driver=f"Who drives? {drives}")
        if not self._is_drawn:
            self._is_drawn = True
            self.page.show_learning([self._history[k] for k in sorted(self._history)])

    def _tell(self, sentence: str) -> None:
        self.page.tell(answer=sentence)

    def _take_robot(self, message: String) -> None:
        if self._states is not None:
            return  # several nodes publish the same description
        with self._health.judging("robot", "Left out a robot"):
            model = compile_model(message.data)
            self._states = states = StateMessages(state_layout(model))
            self._health.arrived(f"{MJCF} from simulation")
            self.page.show_robot(model)
            states.subscribe(self.create_subscription, self._take_state, NEWEST)

    def _take_state(self, messages: dict[str, Any]) -> None:
        self._newest = messages

    def _take_context(self, message: SignalsMsg) -> None:
        with self._health.judging("context", "Left out a context"):
            self.page.used = signals_from_msg(message)

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {value.key: value.value for value in status.values}
            is_near = status.name.startswith(f"{self.get_namespace().rstrip('/')}/")
            if is_near and (sentence := driver(status.message, values)):
                self._drivers[status.name] = time.monotonic(), sentence

    def _take_progress(self, message: LearningProgress) -> None:
        if message.iteration == 1:
            self._history.clear()
        if message.iteration in self._history or len(self._history) < _LONGEST:
            self._history[message.iteration] = progress_from_msg(message)
            self._is_drawn = False


NODE = Runnable(Live, close=lambda node: node.page.close())
