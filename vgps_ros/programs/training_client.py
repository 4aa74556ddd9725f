# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A client of policy_learner's action."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.node import Node
from rclpy.task import Future
from vgps_msgs.action import TrainPolicy
from vgps_msgs.msg import OptimizerIteration

from vgps_ros.core.errors import VgpsError
from vgps_ros.messages.conversions import progress_from_msg
from vgps_ros.ros_runtime.ending import Ending
from vgps_ros.ros_runtime.inbox import Inbox
from vgps_ros.ros_runtime.peers import TRAINING, Peers
from vgps_ros.ros_runtime.qos import STREAM
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
        namespace: in which the learner is.
        ending: takes note of INT and TERM: the first cancels the training, the second does not wait
            for the learner's word.
    """

    def __init__(self, learner: str, lost_timeout: float, namespace: str | None, ending: Ending):
        super().__init__("train_through_graph", namespace=namespace)
        self._ending = ending
        self.action = ActionClient(self, TrainPolicy, f"{learner}/train")
        self._learner = self.resolve_service_name(f"{learner}/train").rpartition("/")[0]
        self._lost_timeout = lost_timeout
        self._nobody = (
            f"There was no policy_learner for {lost_timeout:g} s; start one, and give this command "
            "again."
        )
        self._peers = Peers(self, Inbox(self))
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
            progress.iteration(progress_from_msg(p), p.iterations, p.remaining_seconds)

        shown: set[str] = set()

        def find_solvers() -> None:  # some may be discovered later than the learner
            for topic, types in self.get_topic_names_and_types():
                if "vgps_msgs/msg/OptimizerIteration" in types and topic not in shown:
                    shown.add(topic)
                    self.create_subscription(OptimizerIteration, topic, show_solve, STREAM)

        find_solvers()
        self.create_timer(_WAKE_PERIOD, find_solvers)
        request = partial(self.action.send_goal_async, goal, feedback_callback=show_iteration)
        result = None
        while result is None:
            instance = self._peers.instance_of(self._learner)
            try:
                result = self._result(self._send(request, instance), instance)
            except LostError as error:
                progress.say(str(error))
                self._wait_for_learner(self._lost_timeout, self._nobody)
                self._sent_before = True
        if not result.success:
            raise VgpsError(f"The training ended early: {result.message}")
        return result

    def _wait_for_learner(self, timeout: float, sentence: str) -> None:
        """Waits until a learner is there and heard; raises the sentence if none comes in time."""
        end = time.monotonic() + timeout
        while (
            not self.action.server_is_ready()
            or not self._peers.instance_of(self._learner)
            or self._peers.is_silent(self._learner)
        ):
            self._ending.check()
            if time.monotonic() > end:
                raise VgpsError(sentence)
            self._spin()

    def _result(self, handle: ClientGoalHandle, instance: str) -> TrainPolicy.Result:
        """Asks for the result until the learner that has the goal gives it, or is lost.

        A request may be lost; or a second learner, which is about to be refused, is faster to say
        that it does not know the goal.
        """
        end = float("inf")
        while time.monotonic() < end:
            answer = self._wait(handle.get_result_async(), instance, _RESULT_PERIOD, handle)
            if answer is None:  # the learner is at it, or the request was lost
                end = float("inf")
            elif answer.status != GoalStatus.STATUS_UNKNOWN:
                return answer.result
            else:
                end = min(end, time.monotonic() + _ANSWER_TIMEOUT)
                again = time.monotonic() + _RETRY_PERIOD
                while time.monotonic() < again:
                    self._spin()
        raise LostError("The policy_learner does not know the goal any more; it is sent again.")

    def _send(self, request: Callable[[], Future], instance: str) -> ClientGoalHandle:
        """Sends the goal until a learner accepts it, dies, or refuses it."""
        while True:
            handle = self._wait(request(), instance, _ANSWER_TIMEOUT)
            if handle and handle.accepted:
                return handle
            if handle and not self._sent_before:
                is_busy = self._peers.show(TRAINING, self._learner)
                busy = "is busy with another training; wait for its end."
                refused = "refused the goal; the learner's log says why."
                raise VgpsError(f"The policy_learner {busy if is_busy else refused}")
            # It went to the one that died; or this one is at it already, but its answer was lost.
            self._sent_before = True
            self._wait(Future(), instance, _RETRY_PERIOD)

    def _wait(
        self, future: Future, instance: str, timeout: float, goal: ClientGoalHandle | None = None
    ) -> Any:
        """Returns the learner's answer; an interrupt cancels the goal, where one is given, first.

        Args:
            future: the answer.
            instance: the run of the learner that is to answer.
            timeout: time without an answer of a learner that is well, after which None comes [s].
            goal: the one that an interrupt cancels.

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
                raise VgpsError(self._nobody)
            if waited > timeout:
                return None
            if self._ending.is_wanted and goal and not silent:
                self._cancel(goal, future)
            else:
                self._ending.check()
        return future.result()

    def _cancel(self, goal: ClientGoalHandle, future: Future) -> None:
        print("Cancelling the training ...", flush=True)
        goal.cancel_goal_async()
        end = time.monotonic() + _CANCEL_TIMEOUT
        while not future.done():
            gone = not self.action.server_is_ready()
            if gone or self._ending.is_hurried() or time.monotonic() > end:
                raise VgpsError("The policy_learner did not confirm the cancellation.")
            self._spin()

    def _spin(self) -> float:
        """Takes what has come, or waits for a moment; returns the time that passed [s]."""
        began = time.monotonic()
        rclpy.spin_once(self, timeout_sec=_WAKE_PERIOD)
        self._peers.look()
        # Where this process was stopped meanwhile, nobody is to blame for the silence.
        return min(time.monotonic() - began, 5 * _WAKE_PERIOD)
