"""Node `trajectory_optimizer`: DDP on ᾱ c − log π_θ, as a service that answers with q(ζ)."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from vgps_msgs.msg import OptimizerIteration
from vgps_msgs.msg import TrajectoryDistribution as TrajectoryDistributionMsg
from vgps_msgs.srv import CancelOptimization, OptimizeTrajectory

from vgps_ros.core.ddp import Iteration, Status
from vgps_ros.core.errors import DivergenceError, VgpsError
from vgps_ros.core.simulator_warnings import in_words, simulator_warnings
from vgps_ros.messages.optimization import (
    ENDING,
    TROUBLE,
    iteration_to_msg,
    request_from_msg,
    result_to_msg,
)
from vgps_ros.nodes.executors import ThreadedExecutor
from vgps_ros.nodes.health import Health
from vgps_ros.nodes.parameters import DEMONSTRATION, TASK, declare, declare_settings
from vgps_ros.nodes.qos import LATCHED, STREAM
from vgps_ros.nodes.robot_description import publish_robot_description
from vgps_ros.nodes.runner import run
from vgps_ros.search.preparation import prepare
from vgps_ros.search.trajectory_optimizer import TrajectoryOptimizer
from vgps_ros.tasks import make_task


class TrajectoryOptimizerNode(Node):
    """Serves one solve at a time; a solve can be cancelled and reports its iterations."""

    def __init__(self) -> None:
        super().__init__("trajectory_optimizer")
        task = make_task(
            declare(self, TASK, read_only=True), declare(self, DEMONSTRATION, read_only=True)
        )
        task = replace(task, optimizer=declare_settings(self, task.optimizer))
        prepare(task)  # before the node is there: no request and no peer waits for the compiler
        self._optimizer = TrajectoryOptimizer(task)
        self._health = Health(self)
        self._cancelled = threading.Event()
        self._solving = threading.Event()
        self._worker = ThreadPoolExecutor(1, "solve")  # each thread that computes keeps memory
        self._iterations = self.create_publisher(OptimizerIteration, "~/iterations", STREAM)
        self._distributions = self.create_publisher(
            TrajectoryDistributionMsg, "trajectory_distribution", LATCHED
        )
        # Groups of their own: a solve must not keep the node from being cancelled or diagnosed.
        self.create_service(
            OptimizeTrajectory,
            "~/optimize",
            lambda *request: self._worker.submit(self._optimize, *request).result(),
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self.create_service(
            CancelOptimization,
            "~/cancel",
            self._cancel,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        publish_robot_description(self, task)
        self.get_logger().info(f"Ready to optimise trajectories of the {task.name}.")

    def _optimize(
        self, request: OptimizeTrajectory.Request, response: OptimizeTrajectory.Response
    ) -> OptimizeTrajectory.Response:
        self._cancelled.clear()
        self._solving.set()
        try:
            parsed = request_from_msg(request, self._optimizer.task)

            def publish(iteration: Iteration) -> None:
                stamp = self.get_clock().now().to_msg()
                self._iterations.publish(iteration_to_msg(iteration, parsed, stamp))

            result = self._optimizer.optimize(
                parsed,
                on_iteration=publish,
                is_cancelled=lambda: self._cancelled.is_set() or not self.context.ok(),
            )
        except VgpsError as error:
            response.success = False
            response.status = error.status if isinstance(error, DivergenceError) else "refused"
            response.message = str(error)
            self._health.set_value("last status", response.status)
            self._health.error(f"Refused a request: {error}")
            return response
        finally:
            self._solving.clear()
        if not self.context.ok():
            response.status = ENDING
            response.message = "The node ends, so that the solve is to be done elsewhere."
            return response
        self._health.clear()
        self._health.set_value("last status", result.status.value)
        stamp = self.get_clock().now().to_msg()
        response = result_to_msg(result, parsed, self._optimizer.task, stamp)
        if result.status in TROUBLE:
            self._health.warn(response.message, "solve")
        else:
            self._health.clear("solve")
        self._health.set_value("MuJoCo warnings", in_words(simulator_warnings()))
        if result.status is not Status.CANCELLED:
            self._distributions.publish(response.distribution)
        return response

    def _cancel(
        self, _: CancelOptimization.Request, response: CancelOptimization.Response
    ) -> CancelOptimization.Response:
        response.success = self._solving.is_set()
        self._cancelled.set()
        response.message = "Cancelling the solve." if response.success else "No solve is running."
        return response


def main() -> int:
    """Runs the node; returns the exit code."""
    return run(TrajectoryOptimizerNode, partial(ThreadedExecutor, 3))
