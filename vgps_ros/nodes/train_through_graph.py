"""Program `train_through_graph`: asks a policy_learner to train, and shows how it goes."""

import argparse
import signal
import sys
import time
from collections.abc import Callable, Sequence
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
from vgps_ros.nodes.peers import Peers
from vgps_ros.nodes.qos import STREAM
from vgps_ros.search.result import result_content
from vgps_ros.search.settings import SearchSettings
from vgps_ros.views.plots import learning_curve, save
from vgps_ros.views.training_progress import TrainingProgress

_WAKE_PERIOD = 0.2  # between two looks whether the user has interrupted [s]
# A request to a learner that was just started again may go to the one that was killed [s].
_ANSWER_TIMEOUT = 10.0  # after which a goal is sent again
_RETRY_PERIOD = 1.0  # between two such goals
_CANCEL_TIMEOUT = 15.0  # in which a learner confirms a cancellation [s]
_RESULT_PERIOD = 60.0  # between two requests of the result


class LostError(VgpsError):
    """The learner that had the goal is gone."""


class TrainingClient(Node):
    """Sends a goal to the learner's action and follows it, through deaths of the learner.

    Args:
        learner: name of the learner node.
        lost_timeout: longest time without a learner, once there was one [s].

    Attributes:
        interrupts: how often an end was asked for: once cancels the training, twice does not wait
            for the learner's word. An exception at any place, as Python's own handler of INT raises
            it, could be lost within rclpy.
    """

    def __init__(self, learner: str, lost_timeout: float):
        super().__init__("train_through_graph")
        self.interrupts = 0
        self.action = ActionClient(self, TrainPolicy, f"{learner}/train")
        self._learner = self.resolve_service_name(f"{learner}/train").rpartition("/")[0]
        self._lost_timeout = lost_timeout
        self._peers = Peers(self, owns="")
        self._sent_before = False  # to a learner that may be at it

    def train(
        self, goal: TrainPolicy.Goal, timeout: float, progress: TrainingProgress
    ) -> TrainPolicy.Result:
        """Runs a goal to its end; it is sent again if the learner dies and another one comes.

        Raises:
            VgpsError: the learner does not come, is busy, or fails.
        """
        self._wait_for_learner(
            timeout,
            f"No policy_learner answered within {timeout:g} s; start one with "
            "'ros2 run vgps_ros policy_learner'.",
        )

        def show_solve(message: OptimizerIteration) -> None:
            if message.search_iteration == 0:
                progress.ddp_iteration(message.iteration)

        def show_iteration(feedback: Any) -> None:
            p = feedback.feedback.progress
            progress.iteration(entry_from_msg(p), p.initial_ddp_cost, p.remaining_seconds)

        shown: set[str] = set()

        def find_solvers() -> None:  # some may be discovered later than the learner
            for topic, types in self.get_topic_names_and_types():
                if "vgps_msgs/msg/OptimizerIteration" in types and topic not in shown:
                    shown.add(topic)
                    self.create_subscription(OptimizerIteration, topic, show_solve, STREAM)

        find_solvers()
        self.create_timer(_WAKE_PERIOD, find_solvers)
        result = None
        while result is None:
            result = self._attempt(goal, show_iteration, progress)
        if not result.success:
            raise VgpsError(f"The training ended early: {result.message}")
        return result

    def interrupt(self, *_: object) -> None:
        """Asks for an end; a handler of signals."""
        self.interrupts += 1

    def _wait_for_learner(self, timeout: float, sentence: str) -> None:
        """Waits until a learner is there and heard.

        Raises:
            VgpsError: none came in time.
        """
        end = time.monotonic() + timeout
        while (
            not self.action.server_is_ready()
            or not self._peers.instance_of(self._learner)
            or self._peers.is_silent(self._learner)
        ):
            self._check_interrupt()
            if time.monotonic() > end:
                raise VgpsError(sentence)
            self._spin()

    def _attempt(
        self,
        goal: TrainPolicy.Goal,
        show_iteration: Callable[[Any], None],
        progress: TrainingProgress,
    ) -> TrainPolicy.Result | None:
        """Runs the goal on the learner that is there now; returns None if that one is lost."""
        instance = self._peers.instance_of(self._learner)
        try:
            handle = self._send(goal, show_iteration, instance)
            answer = None
            while answer is None:  # the request may have been lost, too
                answer = self._wait(handle.get_result_async(), instance, _RESULT_PERIOD, handle)
        except LostError as error:
            progress.say(str(error))
            self._wait_for_learner(self._lost_timeout, self._nobody())
            self._sent_before = True
            return None
        return answer.result

    def _send(
        self, goal: TrainPolicy.Goal, show_iteration: Callable[[Any], None], instance: str
    ) -> ClientGoalHandle:
        """Sends the goal until it is accepted.

        Raises:
            LostError: the learner died.
            VgpsError: it is busy with the training of somebody else.
        """
        while True:
            sent = self.action.send_goal_async(goal, feedback_callback=show_iteration)
            handle = self._wait(sent, instance, _ANSWER_TIMEOUT)
            if handle and handle.accepted:
                return handle
            if handle and not self._sent_before:
                raise VgpsError(
                    "The policy_learner is busy with another training; wait for its end."
                )
            # It went to the one that died; or this one is at it already, but its answer was lost.
            self._sent_before = True
            self._wait(Future(), instance, _RETRY_PERIOD)

    def _wait(
        self,
        future: Future,
        instance: str,
        timeout: float,
        cancels: ClientGoalHandle | None = None,
    ) -> Any:
        """Spins until the future is done; an interrupt cancels the goal first.

        Args:
            future: an answer of the learner.
            instance: the run of the learner that is to answer.
            timeout: longest time without an answer of a learner that is well [s].
            cancels: the goal that an interrupt cancels.

        Returns:
            The answer; None if it did not come in time.

        Raises:
            LostError: that learner will not answer any more.
            VgpsError: it is silent for too long, or does not confirm the cancellation.
        """
        waited = silent = 0.0
        while not future.done():
            passed = self._spin()
            if self._peers.is_silent(self._learner):
                silent += passed
            else:
                waited, silent = waited + passed, 0.0
            if self._peers.instance_of(self._learner) != instance:
                raise LostError("The policy_learner has died; its goal is for the next one.")
            if silent > self._lost_timeout:
                raise VgpsError(self._nobody())
            if waited > timeout:
                return None
            if self.interrupts and cancels and not silent:
                self._cancel(cancels, future)
            else:
                self._check_interrupt()
        return future.result()

    def _cancel(self, goal: ClientGoalHandle, future: Future) -> None:
        print("Cancelling the training ...", flush=True)
        goal.cancel_goal_async()
        end = time.monotonic() + _CANCEL_TIMEOUT
        while not future.done():
            gone = not self.action.server_is_ready()
            if gone or self.interrupts > 1 or time.monotonic() > end:
                raise VgpsError("The policy_learner did not confirm the cancellation.")
            self._spin()

    def _spin(self) -> float:
        """Takes what has come, or waits for a moment; returns the time that passed [s]."""
        began = time.monotonic()
        rclpy.spin_once(self, timeout_sec=_WAKE_PERIOD)
        self._peers.look()
        # Where this process was stopped meanwhile, nobody is to blame for the silence.
        return min(time.monotonic() - began, 5 * _WAKE_PERIOD)

    def _nobody(self) -> str:
        return (
            f"There was no policy_learner for {self._lost_timeout:g} s; start one, and give this "
            "command again."
        )

    def _check_interrupt(self) -> None:
        if self.interrupts:
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
    parser.add_argument(
        "--lost-timeout",
        type=float,
        default=300.0,
        help="wait for a learner that was killed or hangs; a new one gets the goal again [s]",
    )
    parsed = parser.parse_args(arguments)
    # INT is this program's own, to cancel the goal; TERM stays rclpy's.
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.SIGTERM)
    node = TrainingClient(parsed.learner, parsed.lost_timeout)
    signal.signal(signal.SIGINT, node.interrupt)
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
