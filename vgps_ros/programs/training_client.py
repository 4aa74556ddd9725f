# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A client of policy_learner's action."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from vgps_msgs.action import TrainPolicy
from vgps_msgs.msg import LearningProgress, OptimizerIteration

from vgps_ros.core.errors import VgpsError
from vgps_ros.messages.conversions import progress_from_msg
from vgps_ros.ros_runtime.qos import STREAM, Liveness
from vgps_ros.ros_runtime.runner import spin_once
from vgps_ros.search.settings import SearchSettings
from vgps_ros.views.console import TrainingProgress

_WAKE_PERIOD = 0.2  # longest wait for a message [s]
# A request to a learner that was just started again may go to the one that was killed [s].
_ANSWER_TIMEOUT = 10.0  # after which a goal is sent again
_RETRY_PERIOD = 1.0  # between two such goals
_CANCEL_TIMEOUT = 15.0  # in which a learner confirms a cancellation [s]
_RESULT_PERIOD = 60.0  # between two requests of the result
_UNKNOWN = 3  # answers that a goal is unknown, until it counts as lost


class TrainingClient(Node):
    """Sends a goal to the learner's action and follows it, through deaths of the learner.

    It waits for another learner for at most `lost_timeout` [s].
    """

    def __init__(self, learner: str, lost_timeout: float, namespace: str | None):
        super().__init__("train_through_graph", namespace=namespace)
        self._action = ActionClient(self, TrainPolicy, f"{learner}/train")
        self._life = Liveness(self, LearningProgress, "learning_progress")
        self._name = self.resolve_service_name(f"{learner}/train").rpartition("/")[0]
        self._lost_timeout = lost_timeout
        self._nobody = (
            f"There was no policy_learner for {lost_timeout:g} s; start one, and give this command "
            "again."
        )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._handle: ClientGoalHandle | None = None  # of the goal that a learner has accepted

    def train(
        self, goal: TrainPolicy.Goal, timeout: float, progress: TrainingProgress
    ) -> TrainPolicy.Result:
        """Runs a goal to its end; it is sent again if the learner dies and another one comes.

        Raises:
            VgpsError: the learner does not come, is busy, or fails.
            KeyboardInterrupt: after the training has been cancelled; a second one does not wait
                for the learner's word.
        """
        self._wait_for_learner(
            timeout,
            f"No policy_learner answered within {timeout:g} s; start one with "
            "'ros2 run vgps_ros policy_learner'.",
        )
        self._show_solves(progress)

        def show_iteration(feedback: Any) -> None:
            p = feedback.feedback.progress
            progress.iteration(progress_from_msg(p), p.iterations, p.remaining_seconds)

        request = partial(self._action.send_goal_async, goal, feedback_callback=show_iteration)
        try:
            result = self._follow(request, progress)
        except KeyboardInterrupt:
            self._cancel()
            raise
        if not result.success:
            raise VgpsError(f"The training ended early: {result.message}")
        return result

    def _show_solves(self, progress: TrainingProgress) -> None:
        """Shows the iterations of the initial DDP, also of optimizers that are discovered late."""
        shown, most = set[str](), SearchSettings().initial_ddp_iterations

        def show_solve(message: OptimizerIteration) -> None:
            if message.search_iteration == 0:
                progress.initial_solves(min(1.0, message.iteration / most))

        def find_solvers() -> None:
            for topic, types in self.get_topic_names_and_types():
                if "vgps_msgs/msg/OptimizerIteration" in types and topic not in shown:
                    shown.add(topic)
                    self.create_subscription(OptimizerIteration, topic, show_solve, STREAM)

        find_solvers()
        self.create_timer(_WAKE_PERIOD, find_solvers)

    def _follow(
        self, request: Callable[[], Future], progress: TrainingProgress
    ) -> TrainPolicy.Result:
        """Sends the goal until a learner accepts it and gives its result."""
        may_be_at_it = False  # the learner refuses a goal, too, that it works on already
        while True:
            handle = self._answer(request(), _ANSWER_TIMEOUT, progress)
            if handle and handle.accepted:
                self._handle = handle
                if result := self._result(handle, progress):
                    return result
                progress.say(
                    "The policy_learner does not know the goal any more; it is sent again."
                )
            elif handle and not may_be_at_it:
                raise VgpsError(
                    "The policy_learner refused the goal: it is busy with another training, or its "
                    "log says what is wrong with this one."
                )
            else:
                self._spin_for(_RETRY_PERIOD)
            may_be_at_it = True

    def _result(
        self, handle: ClientGoalHandle, progress: TrainingProgress
    ) -> TrainPolicy.Result | None:
        """Asks for the result until the learner gives it; returns None if it lost the goal."""
        unknown, period = 0, _RESULT_PERIOD
        while unknown < _UNKNOWN:
            losses = self._life.losses
            answer = self._answer(handle.get_result_async(), period, progress)
            period = _RESULT_PERIOD if self._life.losses == losses else _ANSWER_TIMEOUT
            if answer and answer.status != GoalStatus.STATUS_UNKNOWN:
                return answer.result
            if answer:  # it was started anew, or a second one that is about to be refused is faster
                unknown += 1
                self._spin_for(_RETRY_PERIOD)
        return None

    def _answer(self, future: Future, timeout: float, progress: TrainingProgress) -> Any:
        """Returns the learner's answer; None if it must be asked again.

        A learner that is alive has the timeout [s].
        """
        losses, end = self._life.losses, time.monotonic() + timeout
        while not future.done() and time.monotonic() < end:
            spin_once(self._executor, _WAKE_PERIOD)
            if not self._life.is_alive:
                progress.say(f"{self._name} has ended, was killed, or hangs; waiting for one.")
                self._wait_for_learner(self._lost_timeout, self._nobody)
            if self._life.losses != losses:
                self._wait_for_learner(self._lost_timeout, self._nobody)
                self._spin_for(_WAKE_PERIOD)  # for an answer that has just come
                break
        return future.result() if future.done() else None

    def _wait_for_learner(self, timeout: float, sentence: str) -> None:
        """Waits until a learner is there and alive; raises the sentence if none comes in time."""
        end = time.monotonic() + timeout
        while not (self._life.is_alive and self._action.server_is_ready()):
            if time.monotonic() > end:
                raise VgpsError(sentence)
            self._spin_for(_WAKE_PERIOD)

    def _cancel(self) -> None:
        """Cancels the training; returns once it has ended, or raises VgpsError."""
        if self._handle is None:
            return
        try:
            print("Cancelling the training ...", flush=True)
            self._handle.cancel_goal_async()
            result = self._handle.get_result_async()
            end = time.monotonic() + _CANCEL_TIMEOUT
            while not result.done():
                if not self._action.server_is_ready() or time.monotonic() > end:
                    raise KeyboardInterrupt
                self._spin_for(_WAKE_PERIOD)
        except KeyboardInterrupt:
            raise VgpsError("The policy_learner did not confirm the cancellation.") from None
        raise VgpsError("The training was cancelled.")

    def _spin_for(self, duration: float) -> None:
        """Takes what comes for a time [s]."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            spin_once(self._executor, min(left, _WAKE_PERIOD))
