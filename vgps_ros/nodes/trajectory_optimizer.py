# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `trajectory_optimizer`: DDP on ᾱ c − log π_θ, as a service that answers with q(ζ)."""

import threading
from concurrent.futures import Future as Work
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String
from vgps_msgs.msg import OptimizerIteration
from vgps_msgs.msg import TrajectoryDistribution as TrajectoryDistributionMsg
from vgps_msgs.srv import CancelOptimization, OptimizeTrajectory

from vgps_ros.core.ddp.solve import Iteration, Status
from vgps_ros.core.errors import DivergenceError, VgpsError
from vgps_ros.messages.conversions import outcome_of
from vgps_ros.messages.names import MJCF
from vgps_ros.messages.optimization import (
    TROUBLE,
    iteration_to_msg,
    request_from_msg,
    result_to_msg,
)
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare, declare_settings
from vgps_ros.ros_runtime.qos import CALLS, LATCHED, LATEST, STREAM, lively
from vgps_ros.ros_runtime.runner import Runnable, streaming_executor
from vgps_ros.ros_runtime.services import answer_later
from vgps_ros.search.trajectory_optimization import optimize, prepare
from vgps_ros.simulation.warnings import in_words
from vgps_ros.tasks import make_task
from vgps_ros.tasks.registry import DEMONSTRATION, TASK


@dataclass(eq=False)
class _Accepted:
    """A request that waits or is being solved."""

    request: OptimizeTrajectory.Request
    answer: Future
    cancelled: threading.Event
    work: Work | None = None


class TrajectoryOptimizerNode(Node):
    """Serves one solve at a time; requests can be cancelled, and a solve reports its iterations."""

    def __init__(self) -> None:
        super().__init__("trajectory_optimizer")
        task = make_task(declare(self, TASK), declare(self, DEMONSTRATION))
        task = replace(task, optimizer=declare_settings(self, task.optimizer))
        prepare(task)  # before the node is there: no request and no peer waits for the compiler
        self._task = task
        self._health = Health(self)
        self._accepted: list[_Accepted] = []  # the one that is being solved, and those that wait
        self._shutting_down = threading.Event()
        # A solve must not keep the node from being cancelled or diagnosed.
        self._worker = ThreadPoolExecutor(1, "solve")
        self._iterations = self.create_publisher(OptimizerIteration, "~/iterations", lively(STREAM))
        self._distributions = self.create_publisher(
            TrajectoryDistributionMsg, "trajectory_distribution", LATCHED
        )
        answer_later(
            self.create_service(OptimizeTrajectory, "~/optimize", self._enqueue, qos_profile=CALLS)
        )
        self.create_service(CancelOptimization, "~/cancel", self._cancel, qos_profile=CALLS)
        # Nodes that start later get it too.
        self.create_publisher(String, MJCF, LATEST).publish(String(data=task.mjcf))
        self.get_logger().info(f"Ready to optimise trajectories of the {task.name}.")

    def stop(self) -> None:
        """Hands back what is being solved, and what waits for it."""
        self._shutting_down.set()
        self._worker.shutdown()

    def _enqueue(
        self, request: OptimizeTrajectory.Request, _: object
    ) -> Future | OptimizeTrajectory.Response:
        if len(self._accepted) >= CALLS.depth:
            sentence = f"{CALLS.depth} requests wait already; ask again when they are answered."
            return self._refused(VgpsError(sentence))
        accepted = _Accepted(request, Future(), threading.Event())
        self._accepted.append(accepted)
        accepted.work = self._worker.submit(self._optimize, accepted)
        return accepted.answer

    def _optimize(self, accepted: _Accepted) -> None:
        """Does a solve; whatever keeps it from its end becomes its answer."""
        try:
            response = self._solve(accepted)
        except Exception as error:
            if not self._shutting_down.is_set():
                response = self._refused(error)
        if self._shutting_down.is_set():
            sentence = "The node ends, so that the solve is to be done elsewhere."
            response = _without_solution("shutting_down", sentence)
        self._answer(accepted, response)

    def _answer(self, accepted: _Accepted, response: OptimizeTrajectory.Response) -> None:
        self._accepted.remove(accepted)
        accepted.answer.set_result(response)

    def _solve(self, accepted: _Accepted) -> OptimizeTrajectory.Response:
        request = request_from_msg(accepted.request, self._task)
        request_id = accepted.request.request_id

        def publish(iteration: Iteration) -> None:
            stamp = self.get_clock().now().to_msg()
            self._iterations.publish(iteration_to_msg(iteration, request, request_id, stamp))

        result = optimize(
            self._task,
            request,
            on_iteration=publish,
            is_cancelled=lambda: accepted.cancelled.is_set() or self._shutting_down.is_set(),
        )
        stamp = self.get_clock().now().to_msg()
        response = result_to_msg(result, request, request_id, self._task, stamp)
        self._health.set_value("last status", result.status.value)
        self._health.report("solve", warning=response.message if result.status in TROUBLE else "")
        self._health.set_value("MuJoCo warnings", in_words(self._task.dynamics.warnings()))
        if result.status is not Status.CANCELLED:
            self._distributions.publish(response.distribution)
        return response

    def _refused(self, error: Exception) -> OptimizeTrajectory.Response:
        sentence = self._health.sentence_of(error)
        status = error.status if isinstance(error, DivergenceError) else "refused"
        self._health.set_value("last status", status)
        self._health.report("solve", error=f"Refused a request: {sentence}")
        return _without_solution(status, sentence)

    def _cancel(
        self, request: CancelOptimization.Request, response: CancelOptimization.Response
    ) -> CancelOptimization.Response:
        wanted, are_all = request.request_id, not request.request_id.uuid.any()
        for accepted in [*self._accepted]:
            if are_all or accepted.request.request_id == wanted:
                response.cancelled.append(accepted.request.request_id)
                accepted.cancelled.set()
                if accepted.work and accepted.work.cancel():  # it waits, perhaps for long
                    sentence = "The request was cancelled before its solve began."
                    self._answer(accepted, _without_solution("cancelled", sentence))
        response.success = bool(response.cancelled)
        those = "No request" if are_all else f"No request {bytes(wanted.uuid).hex()}"
        response.message = (
            f"Cancelled {len(response.cancelled)} of the requests."
            if response.success
            else f"{those} waits or is being solved."
        )
        return response


def _without_solution(status: str, sentence: str) -> OptimizeTrajectory.Response:
    return OptimizeTrajectory.Response(outcome=outcome_of(status), message=sentence)


NODE = Runnable(TrajectoryOptimizerNode, streaming_executor, close=lambda node: node.stop())
