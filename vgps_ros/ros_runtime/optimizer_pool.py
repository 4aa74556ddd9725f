"""Solves trajectory optimisations through one or more optimizer nodes."""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from vgps_msgs.srv import CancelOptimization, OptimizeTrajectory

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.settings import Setting
from vgps_ros.messages.optimization import ENDING, request_to_msg, result_from_msg
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import value
from vgps_ros.ros_runtime.steady_timer import steady_timer
from vgps_ros.search.trajectory_optimization import OptimizationRequest, OptimizationResult
from vgps_ros.tasks import Task

OPTIMIZERS = Setting(
    "optimizers",
    ("trajectory_optimizer",),
    "names of the trajectory optimizer nodes that share the solves",
)
OPTIMIZER_TIMEOUT = Setting(
    "optimizer_timeout",
    0.0,
    "time without any optimizer after which a training fails [s]; 0: it waits for one for ever",
    minimum=0.0,
    maximum=1e6,
)

_POLL = 0.1  # between two looks at what is there and what was cancelled [s]
_ASLEEP = 3.0  # between two looks means that this process was stopped, and may lack an answer [s]


class CancelledError(VgpsError):
    """The caller no longer wants the results."""


@dataclass
class _Solve:
    """A request that an optimizer works on: its place, and the run of the node that has it."""

    index: int
    future: Future
    instance: str


class OptimizerPool:
    """Gives each idle optimizer node the next request.

    A request whose optimizer was killed, restarted or hangs goes to another one, or waits until one
    is there. Results do not depend on who solved what.

    Args:
        node: the node, which has declared OPTIMIZERS and OPTIMIZER_TIMEOUT.
        task: whose trajectories are optimised.
        health: of the node.
    """

    def __init__(self, node: Node, task: Task, health: Health):
        names = value(node, OPTIMIZERS)
        self._timeout = value(node, OPTIMIZER_TIMEOUT)
        self._node = node
        self._task = task
        self._health = health
        self._awaited = "the service of " + " or ".join(names)
        group = ReentrantCallbackGroup()
        self._clients = [
            node.create_client(OptimizeTrajectory, f"{name}/optimize", callback_group=group)
            for name in names
        ]
        self._cancel_clients = [
            node.create_client(CancelOptimization, f"{name}/cancel", callback_group=group)
            for name in names
        ]
        steady_timer(node, 1.0, self._ready)

    def optimize_all(
        self, requests: Sequence[OptimizationRequest], is_cancelled: Callable[[], bool]
    ) -> list[OptimizationResult]:
        """Solves all requests, in parallel over the optimizers, and returns results in order.

        Raises:
            CancelledError: `is_cancelled` became true.
            VgpsError: an optimizer refused a request, or none is there for too long.
        """
        waiting = deque(range(len(requests)))
        running: dict[Client, _Solve] = {}
        results: dict[int, OptimizationResult] = {}
        wake = threading.Event()
        looked = there = time.monotonic()
        try:
            while len(results) < len(requests):
                if is_cancelled():
                    raise CancelledError("The training was cancelled.")
                wake.clear()
                asleep = time.monotonic() - looked > _ASLEEP
                looked = time.monotonic()
                self._collect(requests, running, results, waiting, asleep=asleep)
                ready = self._ready()
                there = looked if ready or asleep else there
                if self._timeout and looked - there > self._timeout:
                    raise VgpsError(
                        f"No optimizer was there for {self._timeout:g} s; start {self._awaited}, "
                        "and train again."
                    )
                self._send(ready, requests, waiting, running, wake)
                wake.wait(_POLL)
        finally:
            self._abandon(running)
        return [results[i] for i in range(len(requests))]

    def _collect(
        self,
        requests: Sequence[OptimizationRequest],
        running: dict[Client, _Solve],
        results: dict[int, OptimizationResult],
        waiting: deque[int],
        *,
        asleep: bool,
    ) -> None:
        for client, solve in list(running.items()):
            answer = solve.future.result() if solve.future.done() else None
            if answer and answer.status != ENDING:
                results[solve.index] = result_from_msg(answer, requests[solve.index], self._task)
            elif answer or asleep or self._is_lost(client, solve):
                client.remove_pending_request(solve.future)
                waiting.appendleft(solve.index)
                self._node.get_logger().warning(
                    f"{self._server(client)} is lost with a solve, which is done again."
                )
            else:
                continue
            del running[client]

    def _is_lost(self, client: Client, solve: _Solve) -> bool:
        name, peers = self._server(client), self._health.peers
        solve.instance = solve.instance or peers.instance_of(name)
        restarted = solve.instance != peers.instance_of(name)
        return restarted or peers.is_silent(name) or not client.service_is_ready()

    def _send(
        self,
        ready: list[Client],
        requests: Sequence[OptimizationRequest],
        waiting: deque[int],
        running: dict[Client, _Solve],
        wake: threading.Event,
    ) -> None:
        for client in ready:
            if waiting and client not in running:
                index = waiting.popleft()
                instance = self._health.peers.instance_of(self._server(client))
                stamp = self._node.get_clock().now().to_msg()
                future = client.call_async(request_to_msg(requests[index], self._task, stamp))
                future.add_done_callback(lambda _: wake.set())
                running[client] = _Solve(index, future, instance)

    def _server(self, client: Client) -> str:
        """The full name of the node that serves."""
        return client.service_name.rpartition("/")[0]

    def _ready(self) -> list[Client]:
        """Clients whose optimizer is there and well; says so if there is none."""
        ready = [
            client
            for client in self._clients
            if client.service_is_ready() and not self._health.peers.is_silent(self._server(client))
        ]
        if ready:
            self._health.arrived(self._awaited)
        else:
            self._health.wait_for(self._awaited)
        return ready

    def _abandon(self, running: dict[Client, _Solve]) -> None:
        """Cancels solves whose results nobody waits for any more."""
        for client, solve in running.items():
            client.remove_pending_request(solve.future)
            canceller = self._cancel_clients[self._clients.index(client)]
            if self._node.context.ok() and canceller.service_is_ready():
                canceller.call_async(CancelOptimization.Request())
