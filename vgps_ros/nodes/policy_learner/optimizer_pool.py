# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Solves trajectory optimisations through one or more optimizer nodes."""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rcl_interfaces.srv import GetParameters
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID
from vgps_msgs.msg import OptimizerIteration, SolveStatus
from vgps_msgs.srv import CancelOptimization, OptimizeTrajectory

from vgps_ros.core.errors import DivergenceError, VgpsError
from vgps_ros.core.settings import Range, Setting
from vgps_ros.messages.optimization import request_to_msg, result_from_msg
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import graph_names, value
from vgps_ros.ros_runtime.qos import Liveness
from vgps_ros.ros_runtime.services import steady_timer
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.trajectory_optimization import Outcome
from vgps_ros.tasks import Task

OPTIMIZERS = Setting(
    "optimizers",
    ("trajectory_optimizer",),
    "names of the trajectory optimizer nodes that share the solves",
)
OPTIMIZER_TIMEOUT = Setting(
    "optimizer_timeout",
    0.0,
    Range(0.0, 1e6),
    "time without any optimizer after which a training fails [s]; 0: it waits for one for ever",
)

_POLL = 0.1  # between two looks at what is there and what was cancelled [s]
_GREETING_TIMEOUT = 1.0  # in which a node answers to a greeting, or is greeted again [s]


class CancelledError(VgpsError):
    """The caller no longer wants the results."""


class NoOptimizerError(VgpsError):
    """No optimizer is there for too long."""


@dataclass
class _Optimizer:
    """An optimizer node's clients, and the request that it works on."""

    name: str
    client: Client
    canceller: Client
    greeter: Client  # of a service that answers at once
    life: Liveness
    index: int = -1  # the request's place
    request_id: UUID | None = None
    losses: int = 0  # of the node, when the request was sent
    future: Future | None = None  # its answer; None where the node has nothing to do
    greeting: Future | None = None
    greeted: float = 0.0  # when, by the steady clock [s]


class OptimizerPool:
    """Gives each idle optimizer node the next request.

    A request whose optimizer was killed, restarted or hangs goes to another one, or waits until one
    is there. Results do not depend on who solved what.

    The node has declared OPTIMIZERS and OPTIMIZER_TIMEOUT. Where it needs none, it waits for none.
    """

    def __init__(self, node: Node, task: Task, health: Health, *, is_needed: bool = True):
        self._node, self._task, self._health = node, task, health
        names = graph_names(node, OPTIMIZERS)
        self._awaited = "the service of " + " or ".join(names)
        group = ReentrantCallbackGroup()
        self._optimizers = [
            _Optimizer(
                node.resolve_service_name(f"{name}/optimize").rpartition("/")[0],
                node.create_client(OptimizeTrajectory, f"{name}/optimize", callback_group=group),
                node.create_client(CancelOptimization, f"{name}/cancel", callback_group=group),
                node.create_client(GetParameters, f"{name}/get_parameters", callback_group=group),
                Liveness(node, OptimizerIteration, f"{name}/iterations", group=group),
            )
            for name in names
        ]
        if is_needed:
            steady_timer(node, 1.0, self._ready)

    def optimize_all(
        self, requests: Sequence[OptimizationRequest], is_cancelled: Callable[[], bool]
    ) -> list[Outcome]:
        """Solves all requests, in parallel over the optimizers; their outcomes are in order.

        Raises:
            CancelledError: `is_cancelled` became true.
            NoOptimizerError: no optimizer is there for too long.
            VgpsError: an optimizer refused a request.
        """
        waiting = deque(range(len(requests)))
        results: dict[int, Outcome] = {}
        wake = threading.Event()
        there = time.monotonic()
        try:
            while len(results) < len(requests):
                if is_cancelled():
                    raise CancelledError("The training was cancelled.")
                wake.clear()
                for optimizer in self._optimizers:
                    if answer := self._answer(optimizer, waiting):
                        request = requests[optimizer.index]
                        try:
                            outcome: Outcome = result_from_msg(answer, request, self._task)
                        except DivergenceError as error:
                            outcome = error
                        results[optimizer.index] = outcome
                ready = self._ready()
                now = time.monotonic()
                there = now if ready else there
                timeout = value(self._node, OPTIMIZER_TIMEOUT)
                if timeout and now - there > timeout:
                    raise NoOptimizerError(
                        f"No optimizer was there for {timeout:g} s; start {self._awaited}, "
                        "and train again."
                    )
                for optimizer in ready:
                    if waiting and not optimizer.future:
                        optimizer.index = waiting.popleft()
                        optimizer.losses = optimizer.life.losses
                        stamp = self._node.get_clock().now().to_msg()
                        message = request_to_msg(requests[optimizer.index], self._task, stamp)
                        optimizer.request_id = message.request_id
                        optimizer.future = optimizer.client.call_async(message)
                        optimizer.future.add_done_callback(lambda _: wake.set())
                wake.wait(_POLL)
        finally:
            self._abandon()
        return [results[i] for i in range(len(requests))]

    def _answer(
        self, optimizer: _Optimizer, waiting: deque[int]
    ) -> OptimizeTrajectory.Response | None:
        """Returns an optimizer's answer if it is there; a request that was lost waits again."""
        if not (future := optimizer.future):
            return None
        answer = future.result() if future.done() else None
        if answer and answer.outcome.code != SolveStatus.SHUTTING_DOWN:
            optimizer.future = None
            return answer
        if answer or optimizer.losses != optimizer.life.losses:
            optimizer.future = None
            optimizer.client.remove_pending_request(future)
            waiting.appendleft(optimizer.index)
            sentence = f"{optimizer.name} is lost with a solve, which is done again."
            self._node.get_logger().warning(sentence)
        return None

    def _is_well(self, optimizer: _Optimizer) -> bool:
        """Returns whether an optimizer is alive, and its answers reach this node.

        A node may answer before it has discovered who asks; the answer is lost. So it is asked for
        something small first, again each second.
        """
        if not (optimizer.life.is_alive and optimizer.client.service_is_ready()):
            optimizer.greeting = None
            return False
        now, greeting = time.monotonic(), optimizer.greeting
        late = now - optimizer.greeted > _GREETING_TIMEOUT
        if greeting is None or (late and not greeting.done()):
            optimizer.greeted = now
            greeting = optimizer.greeting = optimizer.greeter.call_async(GetParameters.Request())
        return greeting.done()

    def _ready(self) -> list[_Optimizer]:
        """Returns the optimizers that are there and well; says so if there is none."""
        ready = [optimizer for optimizer in self._optimizers if self._is_well(optimizer)]
        if ready:
            self._health.arrived(self._awaited)
        else:
            self._health.wait_for(self._awaited)
        return ready

    def _abandon(self) -> None:
        """Cancels solves whose results nobody waits for any more."""
        for optimizer in self._optimizers:
            if future := optimizer.future:
                optimizer.future = None
                optimizer.client.remove_pending_request(future)
                if self._node.context.ok() and optimizer.canceller.service_is_ready():
                    optimizer.canceller.call_async(
                        CancelOptimization.Request(request_id=optimizer.request_id)
                    )
