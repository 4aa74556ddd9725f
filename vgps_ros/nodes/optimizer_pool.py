"""Solves trajectory optimisations through one or more optimizer nodes."""

import threading
from collections import deque
from collections.abc import Callable, Sequence

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.task import Future
from vgps_msgs.srv import CancelOptimization, OptimizeTrajectory

from vgps_ros.core.errors import VgpsError
from vgps_ros.messages.optimization import request_to_msg, result_from_msg
from vgps_ros.nodes.health import Health
from vgps_ros.search.trajectory_optimizer import OptimizationRequest, OptimizationResult
from vgps_ros.tasks import Task

_POLL = 0.1  # between two looks at what is there and what was cancelled [s]


class CancelledError(VgpsError):
    """The caller no longer wants the results."""


class OptimizerPool:
    """Gives each idle optimizer node the next request.

    A request whose optimizer disappears goes to another one, or waits until one is there. Results
    do not depend on who solved what.
    """

    def __init__(self, node: Node, names: Sequence[str], task: Task, health: Health):
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
        node.create_timer(1.0, self._ready, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def optimize_all(
        self, requests: Sequence[OptimizationRequest], is_cancelled: Callable[[], bool]
    ) -> list[OptimizationResult]:
        """Solves all requests, in parallel over the optimizers, and returns results in order.

        Raises:
            CancelledError: `is_cancelled` became true.
            VgpsError: an optimizer refused a request.
        """
        waiting = deque(range(len(requests)))
        running: dict[Client, tuple[int, Future]] = {}
        results: dict[int, OptimizationResult] = {}
        wake = threading.Event()
        try:
            while len(results) < len(requests):
                if is_cancelled():
                    raise CancelledError("The training was cancelled.")
                wake.clear()
                self._collect(running, results, waiting)
                self._send(requests, waiting, running, wake)
                wake.wait(_POLL)
        finally:
            self._abandon(running)
        return [results[i] for i in range(len(requests))]

    def _collect(
        self,
        running: dict[Client, tuple[int, Future]],
        results: dict[int, OptimizationResult],
        waiting: deque[int],
    ) -> None:
        for client, (index, future) in list(running.items()):
            if future.done():
                results[index] = result_from_msg(future.result())
            elif client.service_is_ready():
                continue
            else:
                client.remove_pending_request(future)
                waiting.appendleft(index)
            del running[client]

    def _send(
        self,
        requests: Sequence[OptimizationRequest],
        waiting: deque[int],
        running: dict[Client, tuple[int, Future]],
        wake: threading.Event,
    ) -> None:
        for client in self._ready():
            if waiting and client not in running:
                index = waiting.popleft()
                stamp = self._node.get_clock().now().to_msg()
                future = client.call_async(request_to_msg(requests[index], self._task, stamp))
                future.add_done_callback(lambda _: wake.set())
                running[client] = (index, future)

    def _ready(self) -> list[Client]:
        """Clients whose optimizer is there; says so if there is none."""
        ready = [client for client in self._clients if client.service_is_ready()]
        if ready:
            self._health.arrived(self._awaited)
        else:
            self._health.wait_for(self._awaited)
        return ready

    def _abandon(self, running: dict[Client, tuple[int, Future]]) -> None:
        """Cancels solves whose results nobody waits for any more."""
        for client, (_, future) in running.items():
            client.remove_pending_request(future)
            canceller = self._cancel_clients[self._clients.index(client)]
            if self._node.context.ok() and canceller.service_is_ready():
                canceller.call_async(CancelOptimization.Request())
