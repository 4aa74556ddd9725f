# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The live page: the robot in a browser, with what can be done to it.

The page runs in threads of its own. What its visitor wants is put into a queue, from which the
node takes it, so that one thread alone speaks ROS.
"""

import asyncio
import html
import json
import logging
import math
import socket
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import rich
import viser
from simulation_interfaces.msg import SimulationState
from websockets.asyncio.server import ServerConnection, serve
from websockets.typing import Origin

from vgps_ros.core.checks import finite_array, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.nodes.live.robot import LiveRobot
from vgps_ros.robot.signals import Command, Signals
from vgps_ros.search.metrics import IterationMetrics

if TYPE_CHECKING:
    from vgps_ros.nodes.live.node import Live

_NAMES = ("127.0.0.1", "localhost")  # of this machine
_MOST_WISHES = 20  # that wait for the node; older ones are forgotten
_STICK = Path(__file__).with_name("stick.html")
_LONGEST = 4000  # bytes of what a page tells at once
_PULSE = """<iframe hidden srcdoc="<script>parent.eval(`if (window.pulse !== {client}) {{
  window.pulse = {client};
  const socket = window.stickSocket = new WebSocket('ws://127.0.0.1:{port}/{client}');
  setInterval(() => socket.readyState === 1 && socket.send(''), 50);
}}`)</script>"></iframe>"""  # in the page itself, since a panel that is folded loses its frames
_NO_PULSE = 0.5  # time after which a page that says nothing does not pull any more [s]
_STRONGEST = 100.0  # force of a push, in the robot's weight
_STIFFEST = 1e6  # force per metre of a drag [N/m]
_TOP = 100.0  # of the learning curve; what diverged is drawn there
_CURVES = {  # of the learning curve: a metric each, with its name and colour
    "deterministic_cost": ("without noise", "#1f5fbf"),
    "stochastic_cost_mean": ("with noise", "#ff9f1c"),
    "ddp_cost": ("DDP", "#444444"),
}


class LivePage:
    """The page. Its servers listen on 127.0.0.1 alone, and other pages cannot act through them.

    Attributes:
        address: where a browser finds it.
        wishes: what the visitor wants done, the latest of it.
        used: the commands that the controller used last, by their names in its context.

    Args:
        port: TCP port; where another program has it, one of the next.
        actions: does in the graph what the visitor wants.
    """

    def __init__(self, port: int, actions: "Live"):
        self.wishes: deque[Callable[[], None]] = deque(maxlen=_MOST_WISHES)
        self.used: dict[str, float] = {}
        self._held: deque[str] = deque(maxlen=1)  # what the stick told last
        self._pulses: dict[str, float] = {}  # when each page said last that it lives [s]
        rich.get_console().quiet = True  # viser announces itself there
        self._server = server = _Server("127.0.0.1", port, verbose=False)
        listening = socket.create_server(("127.0.0.1", 0))
        Thread(target=asyncio.run, args=(self._listen(listening),), daemon=True).start()
        own_port = listening.getsockname()[1]

        @server.on_client_connect
        def _(client: viser.ClientHandle) -> None:
            client.gui.add_html(_PULSE.format(client=client.client_id, port=own_port))

        self.address = f"http://127.0.0.1:{server.get_port()}"
        gui, self._texts = server.gui, {}
        gui.configure_theme(show_share_button=False, show_logo=False, dark_mode=False)
        gui.set_panel_label("vgps_ros")
        self._actions = actions
        self._robot: LiveRobot | None = None
        self._texts["driver"] = gui.add_html("Waiting for a robot.")
        with gui.add_folder("Simulation"):
            self._texts["run"] = gui.add_html("")
            simulation = actions.simulation
            states = {"Play": SimulationState.STATE_PLAYING, "Pause": SimulationState.STATE_PAUSED}
            wishes = {name: partial(simulation.set, state) for name, state in states.items()}
            self._add_buttons(wishes | {"Reset": simulation.reset})
            self._steps = gui.add_number("Steps", 1, min=1, max=1_000_000, step=1)
            self._add_buttons({"Step": lambda: simulation.step(int(self._steps.value))})
            self._texts["answer"] = gui.add_html("")
        self._driving = gui.add_folder("Drive", visible=False)
        with self._driving:
            self._stick = gui.add_html("")
            self._texts["used"] = gui.add_html("")
        self._commands: tuple[Command, ...] = ()
        with gui.add_folder("Push: drag a body"):
            self._pull: Any = gui.add_number("N per m", 1.0, min=0.0, max=_STIFFEST)
            self._texts["push"] = gui.add_html("")
        self._cost = gui.add_folder("Cost of the plans", visible=False)
        self._sliders: dict[tuple[str, int], Any] = {}
        self._learning = gui.add_folder("Learning", visible=False)
        self._curve: Any = None

    def close(self) -> None:
        """Ends the server."""
        self._server.stop()

    def show_robot(self, model: mujoco.MjModel) -> None:
        """Shows a robot in its model's first state."""
        self._robot = LiveRobot(self._server, model)
        self._pull.value = float(f"{10.0 * self._robot.mass / self._robot.size:.2g}")

    def show_state(self, state: Array) -> None:
        """Shows the robot in a state x, shape (n_x,)."""
        if self._robot:
            self._robot.show(state)

    def push(self) -> tuple[str, Array] | None:
        """Returns the push of a user who drags the robot by the mouse, and shows it.

        Returns:
            A body, and a force [N] at its origin and a torque [N·m] along its axes, shape (6,).
        """
        robot = self._robot
        if robot is None or (grabbed := robot.grabbed(self._lives)) is None:
            return None
        body, point, pull = grabbed
        stiffness = min(max(float(self._pull.value), 0.0), _STIFFEST)
        force = _at_most(stiffness * pull, _STRONGEST * 9.81 * robot.mass)
        wrench = np.concatenate([force, np.cross(_at_most(point, robot.size), force)])
        if not np.isfinite(wrench).all():
            return None
        self.tell(push=f"Last push: {body} with {np.linalg.norm(force):.3g} N.")
        return body, wrench

    def commands(self) -> dict[str, float] | None:
        """Returns all commands by name if the stick has told something new.

        Those that it does not name are at rest, and all are within their ranges.

        Raises:
            InvalidInputError: it told something else than a number for some of the commands.
        """
        signals = Signals(self._commands)
        text = self._held.popleft() if self._held else None
        if text is None or not signals.commands:
            return None
        told = json.loads(text)
        if not isinstance(told, dict):
            raise InvalidInputError(f"the stick tells {quote(told)}, but no values by name.")
        values = finite_array("The stick", [*told.values()], (len(told),)).tolist()
        taken, _ = signals.clamped(dict(zip(told, values, strict=True)))
        return {c.name: taken.get(i, c.rest) for i, c in enumerate(signals.commands)}

    def show_commands(self, commands: Sequence[Command]) -> None:
        """Shows a stick for these commands, and what became of them; nothing without commands."""
        if tuple(commands) != self._commands:
            self._commands, self.used = tuple(commands), {}
            self._stick.content = _stick(commands)
            self._driving.visible = bool(commands)
        lines = []
        for command in commands:
            if (used := self.used.get(f"command/{command.name}")) is not None:
                done = self._done(command)
                is_known = "" if done is None else f", actual {done:.2f}"
                lines.append(f"{command.name}: command {used:.2f}{is_known} {command.unit}")
        self.tell(used="\n".join(lines))

    def tell(self, **texts: str) -> None:
        """Shows sentences, which may come from anybody: none is read as HTML.

        Args:
            texts: by place: `driver` says who drives, `run` how the simulation runs, `answer` what
                the last wish came to, `push` what the last push was, `used` what commands do.
        """
        for place, text in texts.items():
            lines = html.escape(text).replace("\n", "<br>")
            content = f'<p style="margin: 0.4em 0.8em">{lines}</p>'
            if self._texts[place].content != content:
                self._texts[place].content = content

    def show_cost(self, names: Sequence[str], targets: Array, weights: Array) -> None:
        """Shows the planner's cost; sliders are made for readings that are new."""
        self._cost.visible = bool(len(names))
        for i, name in enumerate(names):
            for kind, values in (("target", targets), ("weight", weights)):
                value, slider = float(values[i]), self._sliders.get((kind, i))
                if slider is None or slider.label != f"{name} {kind}":
                    self._add_slider(kind, i, name, value)
                elif slider.min <= value <= slider.max and slider.value != value:
                    slider.value = value

    def show_learning(self, history: Sequence[IterationMetrics]) -> None:
        """Draws costs by iteration, as multiples of the initial DDP solution's."""
        first = history[-1].initial_ddp_cost or 1.0  # a cost of 0 has no multiples
        curves = [np.array([float(metrics.k) for metrics in history])]
        for name in _CURVES:
            ratios = np.array([getattr(metrics, name) / first for metrics in history])
            # The plot would draw NaN at the bottom, and one large value would flatten the rest.
            curves.append(np.nan_to_num(ratios, nan=_TOP).clip(max=_TOP))
        if self._curve is not None:
            self._curve.data = tuple(curves)
            return
        self._learning.visible = True
        series: list[Any] = [{"label": "iteration"}]
        for label, colour in _CURVES.values():
            series.append({"label": label, "stroke": colour, "width": 2})
        with self._learning:
            self._curve = self._server.gui.add_uplot(
                tuple(curves),
                tuple(series),
                title="cost ÷ initial DDP cost",
                scales={"x": {"time": False}, "y": {"distr": 3}},
                aspect=1.5,
            )

    def _done(self, command: Command) -> float | None:
        """Returns the robot's own speed that a command of cmd_vel asks for, None for others."""
        if not command.source or self._robot is None:
            return None
        _, kind, axis = command.source.split("/")
        place = 3 * ("angular", "linear").index(kind) + "xyz".index(axis)
        return float(self._robot.velocity[place])

    def _lives(self, client: int) -> bool:
        """Returns whether a page has just said that it is neither gone nor frozen."""
        return time.monotonic() - self._pulses.get(str(client), -math.inf) < _NO_PULSE

    def _is_page(self, client: int | None) -> bool:
        """Returns whether a client of viser is the live page, not another page of the browser."""
        return str(client) in self._pulses

    async def _listen(self, listening: socket.socket) -> None:
        """Hears what the live page says, whose origin browsers tell; viser hears every page."""
        origins = [Origin(f"http://{name}:{self._server.get_port()}") for name in _NAMES]
        quiet = logging.Logger("of what pages do wrong", logging.CRITICAL)
        limits: Any = {"origins": origins, "max_size": _LONGEST, "logger": quiet}
        async with serve(self._follow, sock=listening, **limits) as server:
            await server.serve_forever()

    async def _follow(self, connection: ServerConnection) -> None:
        """Notes that a page lives, whose number is its path, and what its stick tells."""
        assert connection.request
        page, last = connection.request.path[1:], "{}"
        try:
            async for text in connection:
                self._pulses[page] = time.monotonic()
                if text:
                    last = str(text)
                    self._held.append(last)
        finally:
            self._pulses.pop(page, None)
            if last != "{}":  # the page is lost, and its stick is let go
                self._held.append("{}")

    def _add_buttons(self, wishes: dict[str, Callable[[], None]]) -> None:
        group = self._server.gui.add_button_group("", tuple(wishes))

        @group.on_click
        async def _(event: Any) -> None:  # at once, before another click
            if self._is_page(event.client_id):
                self.wishes.append(wishes[event.target.value])

    def _add_slider(self, kind: str, i: int, name: str, value: float) -> None:
        reach = max(1.0, 2.0 * abs(value))
        low, high = (0.0, 2.0 * reach) if kind == "weight" else (value - reach, value + reach)
        step = 10.0 ** (math.floor(math.log10(high - low)) - 2)
        if old := self._sliders.pop((kind, i), None):
            old.remove()
        with self._cost:
            slider = self._server.gui.add_slider(f"{name} {kind}", low, high, step, value)
        self._sliders[kind, i] = slider

        @slider.on_update
        def _(event: Any) -> None:
            if self._is_page(event.client_id):  # moved by a visitor
                self.wishes.append(self._set_cost)

    def _set_cost(self) -> None:
        count = len(self._sliders) // 2
        values = [[self._sliders[k, i].value for i in range(count)] for k in ("target", "weight")]
        self._actions.cost.set(*values)


class _Server(viser.ViserServer):
    """A server whose page is for this machine."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Shares the page with nobody, whoever asks."""


def _at_most(vector: Array, length: float) -> Array:
    """Returns a vector, or one of this length in its direction where it is longer."""
    return vector * min(1.0, length / max(float(np.linalg.norm(vector)), 1e-9))


def _stick(commands: Sequence[Command]) -> str:
    """Returns the HTML of a stick for some commands, whose names may come from anybody."""
    axes = [
        {"name": c.name, "unit": c.unit, "low": c.lowest, "high": c.highest, "rest": c.rest}
        # REP-103: what moves or turns to the left is positive.
        | {"left": c.source[-1:] in ("y", "z")}
        for c in commands
    ]
    height = 148 + 62 * max(0, len(axes) - 2)
    return (
        f'<iframe title="stick" style="border: 0; width: 100%; height: {height}px" '
        f'data-axes="{html.escape(json.dumps(axes))}" '
        f'srcdoc="{html.escape(_STICK.read_text())}"></iframe>'
    )
