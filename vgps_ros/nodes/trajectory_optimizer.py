# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `trajectory_optimizer`: DDP on ᾱ c − log π_θ, as a service that answers with q(ζ)."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String
from vgps_msgs.msg import OptimizerIteration
from vgps_msgs.msg import TrajectoryDistribution as TrajectoryDistributionMsg
from vgps_msgs.srv import CancelOptimization, OptimizeTrajectory

from vgps_ros.core.ddp.solve import Iteration, Status
from vgps_ros.core.errors import DivergenceError, VgpsError
from vgps_ros.messages.names import MJCF
from vgps_ros.messages.optimization import (
    SHUTTING_DOWN,
    TROUBLE,
    iteration_to_msg,
    request_from_msg,
    result_to_msg,
)
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare, declare_settings
from vgps_ros.ros_runtime.qos import CALLS, LATCHED, LATEST, STREAM, lively
from vgps_ros.ros_runtime.runner import run, streaming_executor
from vgps_ros.ros_runtime.services import answer_later
from vgps_ros.search.trajectory_optimization import optimize, prepare
from vgps_ros.simulation.warnings import in_words
from vgps_ros.tasks import make_task
from vgps_ros.tasks.registry import DEMONSTRATION, TASK


class TrajectoryOptimizerNode(Node):
    """Serves one solve at a time; a solve can be cancelled and reports its iterations."""

    def __init__(self) -> None:
        super().__init__("trajectory_optimizer")
        task = make_task(declare(self, TASK), declare(self, DEMONSTRATION))
        task = replace(task, optimizer=declare_settings(self, task.optimizer))
        prepare(task)  # before the node is there: no request and no peer waits for the compiler
        self._task = task
        self._health = Health(self)
        self._cancelled = threading.Event()
        self._solving = threading.Event()
        self._shutting_down = threading.Event()
        # A solve must not keep the node from being cancelled or diagnosed.
        self._worker = ThreadPoolExecutor(1, "solve")
        self._places = threading.Semaphore(CALLS.depth)  # for requests that wait or are solved
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
        if not self._places.acquire(blocking=False):
            sentence = f"{CALLS.depth} requests wait already; ask again when they are answered."
            return self._refused(VgpsError(sentence))
        answer = Future()
        self._worker.submit(lambda: answer.set_result(self._optimize(request)))
        return answer

    def _optimize(self, request: OptimizeTrajectory.Request) -> OptimizeTrajectory.Response:
        """Does a solve; whatever keeps it from its end becomes its answer."""
        self._cancelled.clear()
        self._solving.set()
        try:
            response = self._solve(request)
        except Exception as error:
            if not self._shutting_down.is_set():
                return self._refused(error)
        finally:
            self._solving.clear()
            self._places.release()
        if self._shutting_down.is_set():
            sentence = "The node ends, so that the solve is to be done elsewhere."
            return OptimizeTrajectory.Response(status=SHUTTING_DOWN, message=sentence)
        return response

    def _solve(self, message: OptimizeTrajectory.Request) -> OptimizeTrajectory.Response:
        request = request_from_msg(message, self._task)

        def publish(iteration: Iteration) -> None:
            stamp = self.get_clock().now().to_msg()
            self._iterations.publish(iteration_to_msg(iteration, request, stamp))

        result = optimize(
            self._task,
            request,
            on_iteration=publish,
            is_cancelled=lambda: self._cancelled.is_set() or self._shutting_down.is_set(),
        )
        stamp = self.get_clock().now().to_msg()
        response = result_to_msg(result, request, self._task, stamp)
        self._health.set_value("last status", response.status)
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
        return OptimizeTrajectory.Response(status=status, message=sentence)

    def _cancel(self, *_: object) -> CancelOptimization.Response:
        is_solving = self._solving.is_set()
        self._cancelled.set()
        message = "Cancelling the solve." if is_solving else "No solve is running."
        return CancelOptimization.Response(success=is_solving, message=message)


def main() -> int:
    """Runs the node; returns the exit code."""
    return run(TrajectoryOptimizerNode, streaming_executor, close=lambda node: node.stop())
