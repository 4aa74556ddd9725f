# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `policy_learner`: drives a policy search over the optimizers' services, as an action."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from vgps_msgs.action import TrainPolicy
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg
from vgps_msgs.msg import LearningProgress

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.settings import Setting, with_values
from vgps_ros.messages.conversions import policy_to_msg, progress_to_msg, robot_of
from vgps_ros.nodes.policy_learner.optimizer_pool import (
    OPTIMIZER_TIMEOUT,
    OPTIMIZERS,
    CancelledError,
    NoOptimizerError,
    OptimizerPool,
)
from vgps_ros.nodes.policy_learner.robots import ROLLOUT_ROBOTS, ROLLOUT_TIMEOUT, Robots
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare, declare_settings, graph_names
from vgps_ros.ros_runtime.qos import CALLS, LATEST, STREAM, lively
from vgps_ros.ros_runtime.runner import Runnable
from vgps_ros.search.settings import METHOD, SearchSettings, architecture, search_settings
from vgps_ros.search.trajectory_optimization import prepare
from vgps_ros.tasks import make_task
from vgps_ros.tasks.disturbance import DisturbanceSettings
from vgps_ros.tasks.registry import DEMONSTRATION, TASK

_SUBSCRIBER_TIMEOUT = 0.2  # to wait for late subscribers [s]

_TRAINING = "training"  # key of a value on /diagnostics: how far it is

CHECKPOINT_FOLDER = Setting(
    "checkpoint_folder",
    "",
    "folder in which each training is kept as it goes: where the learner was killed, the same goal "
    "goes on after the last whole iteration; empty: it begins anew",
)


class PolicyLearner(Node):
    """Trains one policy at a time; publishes each iteration's policy and progress."""

    def __init__(self) -> None:
        super().__init__("policy_learner")
        self._task = make_task(declare(self, TASK), declare(self, DEMONSTRATION))
        self._method = declare(self, METHOD)
        self._settings = declare_settings(self, search_settings(self._task))
        self._checkpoint_folder = declare(self, CHECKPOINT_FOLDER)
        declare(self, OPTIMIZERS)
        declare(self, OPTIMIZER_TIMEOUT, may_change=True)
        declare(self, ROLLOUT_ROBOTS)
        names = graph_names(self, ROLLOUT_ROBOTS)
        declare(self, ROLLOUT_TIMEOUT, may_change=True)
        needs_optimizer = self._method != "mdgps" or self._settings.mirror.dynamics == "model"
        if names and (needs_optimizer or self._settings.disturb != DisturbanceSettings()):
            raise InvalidInputError(
                f"rollout_robots is {quote(names)}, but rollouts are enough only for method mdgps "
                "with mirror.dynamics fitted, and robots are not disturbed: set both, and nothing "
                "of disturb, or leave rollout_robots out."
            )
        prepare(self._task)  # before the node is there: no peer waits for the compiler
        self._health = Health(self, owns=("learning_progress",))
        self._pool = OptimizerPool(self, self._task, self._health, is_needed=needs_optimizer)
        self._robots = Robots(self, names, self._task, self._health) if names else None
        if self._robots:
            self._task = self._robots.task
        self._busy = threading.Lock()
        self._worker = ThreadPoolExecutor(1, "search")  # each thread that computes keeps memory
        self._policies = self.create_publisher(GaussianPolicyMsg, "policy", LATEST)
        self._progress = self.create_publisher(
            LearningProgress, "learning_progress", lively(STREAM)
        )
        self._action = ActionServer(
            self,
            TrainPolicy,
            "~/train",
            lambda goal: self._worker.submit(self._train, goal).result(),
            goal_callback=self._judge,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
            goal_service_qos_profile=CALLS,
            result_service_qos_profile=CALLS,
            cancel_service_qos_profile=CALLS,
        )
        self.get_logger().info(
            f"Ready to train policies for the {self._task.name} by {self._method}."
        )

    def destroy_node(self) -> None:
        """Leaves the graph."""
        if self._robots:
            self._robots.close()
        super().destroy_node()

    def _judge(self, goal: TrainPolicy.Goal) -> GoalResponse:
        """Refuses a goal while another one is accepted, or if a value of it is wrong."""
        try:
            self._settings_of(goal)
        except InvalidInputError as error:
            self.get_logger().warning(f"Refused a goal: {error}")
            return GoalResponse.REJECT
        is_free = self._busy.acquire(blocking=False)
        return GoalResponse.ACCEPT if is_free else GoalResponse.REJECT

    def _settings_of(self, goal: TrainPolicy.Goal) -> SearchSettings:
        """Returns the node's settings with what the goal says in place of them."""
        given = {"iterations": goal.iterations[0]} if goal.iterations else {}
        if goal.hidden_units:
            given["hidden_units"] = tuple(goal.hidden_units)
        settings = with_values(self._settings, given)
        architecture(self._task, settings)  # refuses a policy that is too large
        return settings

    def _train(self, goal: ServerGoalHandle) -> TrainPolicy.Result:
        result = TrainPolicy.Result(outcome=TrainPolicy.Result.FAILED)
        self._health.clear("training")
        self._health.set_value(_TRAINING, "initial DDP")
        try:
            self._run(goal, result)
        except CancelledError as error:
            result.outcome, result.message = TrainPolicy.Result.CANCELLED, str(error)
            if goal.is_cancel_requested:
                goal.canceled()
        except Exception as error:
            if not self.context.ok():
                raise  # nobody can be told any more
            if isinstance(error, NoOptimizerError):
                result.outcome = TrainPolicy.Result.NO_OPTIMIZER
            elif isinstance(error, DivergenceError):
                result.outcome = TrainPolicy.Result.DIVERGED
            result.message = self._health.sentence_of(error)
            self._health.report("training", error=f"The training failed: {result.message}")
            goal.abort()
        else:
            result.outcome, result.success = TrainPolicy.Result.FINISHED, True
            goal.succeed()
        finally:
            self._health.set_value(_TRAINING, "")
            self._busy.release()
        return result

    def _run(self, goal: ServerGoalHandle, result: TrainPolicy.Result) -> None:
        """Runs the search and fills in the result as it goes."""
        # Not before the first training: torch takes seconds to import.
        from vgps_ros.search.iteration import RemainingTime
        from vgps_ros.search.methods import search

        seed = int(goal.request.seed)
        settings = self._settings_of(goal.request)

        def is_cancelled() -> bool:
            return goal.is_cancel_requested or not self.context.ok()

        if self._robots:
            self._robots.is_cancelled = is_cancelled
        remaining = RemainingTime(settings.iterations)
        trouble = ""  # of the last iteration that had any
        for iteration in search(
            self._method,
            self._task,
            settings,
            seed,
            lambda requests: self._pool.optimize_all(requests, is_cancelled),
            self._checkpoints(settings, seed),
        ):
            if is_cancelled():
                raise CancelledError("The training was cancelled.")
            stamp = self.get_clock().now().to_msg()
            said = {
                "task": self._task.name,
                "method": self._method,
                "seed": seed,
                "iterations": settings.iterations,
                "remaining_seconds": remaining.after(iteration),
            }
            # More than one where the training goes on from a checkpoint.
            figures = iteration.history[len(result.history) :]
            news = [progress_to_msg(each, stamp=stamp, **said) for each in figures]
            of = (self._task.name, iteration.k, stamp, robot_of(self._task.deployment))
            result.policy = policy_to_msg(iteration.policy, *of)
            result.num_parameters = iteration.policy.architecture.num_parameters
            result.history = [*result.history, *news]
            self._await_readers()
            self._policies.publish(result.policy)
            self._progress.publish(news[-1])
            goal.publish_feedback(TrainPolicy.Feedback(progress=news[-1]))
            self._health.set_value(_TRAINING, f"iteration {iteration.k} of {settings.iterations}")
            self._health.report("iteration", warning=" ".join(iteration.warnings))
            if iteration.warnings:
                result.troubled_iterations.append(iteration.k)
                trouble = f"iteration {iteration.k}: {' '.join(iteration.warnings)}"
        result.message = f"Trained for {len(result.history)} iterations."
        if trouble:
            result.message += f" {len(result.troubled_iterations)} had trouble, last {trouble}"

    def _checkpoints(self, settings: SearchSettings, seed: int) -> Any:
        """Returns checkpoints whose failure is reported, but stops no training; or None."""
        if not self._checkpoint_folder:
            return None
        from vgps_ros.search.checkpoints import Checkpoints, Run

        health = self._health

        class Kept(Checkpoints):
            """Checkpoints whose failure is reported."""

            def save(self, *of: Any) -> None:
                """Writes a checkpoint if it can."""
                try:
                    super().save(*of)
                    health.clear("checkpoints")
                except OSError as error:
                    sentence = (
                        f"The training goes on, but no checkpoint can be written to '{self.folder}'"
                        f" ({error.strerror}): make room, or make it writable."
                    )
                    health.report("checkpoints", error=sentence)

        name = Run(self._method, self._task, settings, seed).name()
        return Kept(Path(self._checkpoint_folder, name), self.get_logger().info)

    def _await_readers(self) -> None:
        """Lets readers take the policy before: the topic keeps one, which the next one replaces."""
        end = time.monotonic() + _SUBSCRIBER_TIMEOUT
        while time.monotonic() < end and not self._policies.wait_for_all_acked(Duration()):
            time.sleep(0.002)


NODE = Runnable(PolicyLearner, partial(MultiThreadedExecutor, 4))
