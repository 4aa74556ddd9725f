"""Program `train_through_graph`: asks a policy_learner to train, and shows how it goes."""

import argparse
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.task import Future
from vgps_msgs.action import TrainPolicy
from vgps_msgs.msg import OptimizerIteration

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.policy_file import save_policy, write_json
from vgps_ros.messages.conversions import policy_from_msg
from vgps_ros.messages.progress import entry_from_msg
from vgps_ros.nodes.qos import STREAM
from vgps_ros.search.result import result_content
from vgps_ros.search.settings import SearchSettings
from vgps_ros.views.plots import learning_curve, save
from vgps_ros.views.training_progress import TrainingProgress

_WAKE_PERIOD = 0.2  # between two looks whether the user has interrupted [s]


class TrainingClient(Node):
    """Sends one goal to the learner's action and follows it.

    Attributes:
        interrupted: set by whoever wants an end; an exception at any place, as Python's own handler
            of INT raises it, could be lost within rclpy.
    """

    def __init__(self, learner: str):
        super().__init__("train_through_graph")
        self.interrupted = threading.Event()
        self.action = ActionClient(self, TrainPolicy, f"{learner}/train")

    def train(
        self, goal: TrainPolicy.Goal, timeout: float, progress: TrainingProgress
    ) -> TrainPolicy.Result:
        """Runs one goal to its end.

        Raises:
            VgpsError: the learner does not come, is busy, or fails.
        """
        end = time.monotonic() + timeout
        while not self.action.wait_for_server(timeout_sec=_WAKE_PERIOD):
            self._check_interrupt()
            if time.monotonic() > end:
                raise VgpsError(
                    f"No policy_learner answered within {timeout:g} s; start one with "
                    "'ros2 run vgps_ros policy_learner'."
                )

        def show_solve(message: OptimizerIteration) -> None:
            if message.search_iteration == 0:
                progress.ddp_iteration(message.iteration)

        def show_iteration(feedback: Any) -> None:
            p = feedback.feedback.progress
            progress.iteration(entry_from_msg(p), p.initial_ddp_cost, p.remaining_seconds)

        for topic, types in self.get_topic_names_and_types():
            if "vgps_msgs/msg/OptimizerIteration" in types:
                self.create_subscription(OptimizerIteration, topic, show_solve, STREAM)
        handle = self._wait(self.action.send_goal_async(goal, feedback_callback=show_iteration))
        if not handle.accepted:
            raise VgpsError("The policy_learner is busy with another training; wait for its end.")
        result = self._wait(handle.get_result_async(), cancels=handle).result
        if not result.success:
            raise VgpsError(f"The training ended early: {result.message}")
        return result

    def _wait(self, future: Future, cancels: ClientGoalHandle | None = None) -> Any:
        """Spins until the future is done; an interrupt cancels the goal first."""
        while not future.done():
            rclpy.spin_until_future_complete(self, future, timeout_sec=_WAKE_PERIOD)
            if cancels is None:
                self._check_interrupt()
            elif self.interrupted.is_set():
                print("Cancelling the training ...", flush=True)
                rclpy.spin_until_future_complete(self, cancels.cancel_goal_async(), timeout_sec=5.0)
                rclpy.spin_until_future_complete(self, future, timeout_sec=10.0)
                if not future.done():
                    raise VgpsError("The policy_learner did not confirm the cancellation.")
        return future.result()

    def _check_interrupt(self) -> None:
        if self.interrupted.is_set():
            raise KeyboardInterrupt


def write_result(result: TrainPolicy.Result, output: Path) -> None:
    """Writes result.json, policy.json and learning_curve.png, as `train` does."""
    last = result.history[-1]
    policy = policy_from_msg(result.policy)
    content = result_content(
        task=last.task,
        method=last.method,
        seed=int(last.seed),
        hidden_units=policy.architecture.hidden_units,
        num_parameters=int(result.num_parameters),
        initial_ddp_cost=last.initial_ddp_cost,
        iterations=[entry_from_msg(message) for message in result.history],
    )
    output.mkdir(parents=True, exist_ok=True)
    write_json(output / "result.json", content)
    save_policy(policy, last.task, output / "policy.json")
    save(learning_curve(content), output / "learning_curve.png")


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    defaults = SearchSettings()
    parser = argparse.ArgumentParser(
        prog="train_through_graph",
        description="Asks a running policy_learner for a training, shows its progress, and writes "
        "result.json, policy.json and learning_curve.png. Ctrl-C cancels the training.",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random draws")
    parser.add_argument(
        "--iterations",
        type=int,
        default=defaults.iterations,
        help="iterations, each with one policy update",
    )
    parser.add_argument(
        "--hidden-units",
        type=int,
        nargs="+",
        default=list(defaults.hidden_units),
        help="width of each hidden layer",
    )
    parser.add_argument("--output", type=Path, required=True, help="folder for the results")
    parser.add_argument("--learner", default="policy_learner", help="name of the learner node")
    parser.add_argument("--timeout", type=float, default=20.0, help="wait for the learner [s]")
    parsed = parser.parse_args(arguments)
    # INT is this program's own, to cancel the goal; TERM stays rclpy's.
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.SIGTERM)
    node = TrainingClient(parsed.learner)
    signal.signal(signal.SIGINT, lambda *_: node.interrupted.set())
    try:
        goal = TrainPolicy.Goal(
            seed=parsed.seed, iterations=parsed.iterations, hidden_units=parsed.hidden_units
        )
        with TrainingProgress(parsed.iterations, defaults.initial_ddp_iterations) as progress:
            result = node.train(goal, parsed.timeout, progress)
        write_result(result, parsed.output)
        print(f"Wrote result.json, policy.json and learning_curve.png to {parsed.output}.")
    except (VgpsError, OSError, AssertionError) as error:
        sys.exit(f"train_through_graph: {error}")
    except (KeyboardInterrupt, ExternalShutdownException):
        sys.exit("train_through_graph: interrupted.")
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        node.destroy_node()
        rclpy.try_shutdown()
