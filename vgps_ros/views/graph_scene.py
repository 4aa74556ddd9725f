# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Draws the messages that pass between the nodes into a Rerun recording.

The node `visualizer` does so live and `vgps bag rerun` from a bag; both give the same recording,
since only this module knows how to draw a message. The topic `mjcf_description` says which robot
there is, so the messages before it are kept until it comes.
"""

import io
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from vgps_ros.core.checks import finite_array, positive
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.messages.conversions import (
    check_robot,
    command_from_msg,
    distribution_from_msg,
    efforts_from_msg,
    gains_from_msg,
    nanoseconds,
    policy_from_msg,
    result_from_msgs,
    signals_from_msg,
    trajectory_from_msg,
)
from vgps_ros.messages.names import CONTEXT, GAINS, MJCF
from vgps_ros.messages.robot_state import JOINTS, TOPICS, StateCollector
from vgps_ros.search.metrics import METRICS
from vgps_ros.views.blueprint import LEARNING_CURVE
from vgps_ros.views.learning_curve import learning_curve
from vgps_ros.views.recording import Recording
from vgps_ros.views.robot_scene import RobotScene

_LONGEST = 10_000  # iterations of a training whose learning curve is drawn
_MOST_WAITING = 100_000  # messages kept until the robot is known; then the oldest are dropped
DRAWN = {  # topics that are drawn, and their types
    MJCF: "std_msgs/msg/String",
    "odom": "nav_msgs/msg/Odometry",
    "multi_dof_joint_states": "sensor_msgs/msg/MultiDOFJointState",
    "activations": "sensor_msgs/msg/JointState",
    "joint_states": "sensor_msgs/msg/JointState",
    "joint_command": "sensor_msgs/msg/JointState",
    CONTEXT: "vgps_msgs/msg/Signals",
    GAINS: "vgps_msgs/msg/Signals",
    "learning_progress": "vgps_msgs/msg/LearningProgress",
    "plan": "vgps_msgs/msg/Plan",
    "policy": "vgps_msgs/msg/GaussianPolicy",
    "trajectory_distribution": "vgps_msgs/msg/TrajectoryDistribution",
    "iterations": "vgps_msgs/msg/OptimizerIteration",  # one topic for each optimizer
}


def is_drawn(topic: str, kind: str) -> bool:
    """Returns whether messages of this topic and type are drawn, in any namespace."""
    return DRAWN.get(topic.rpartition("/")[2]) == kind


class GraphScene:
    """Draws messages. A message that does not fit the robot is left out and reported.

    Args:
        path: file for the recording, which must not exist yet.
        report: called for each message with the topic, and with a sentence on why the message was
            left out, or None if it was drawn.

    Attributes:
        recording: the recording that is written.

    Raises:
        InvalidInputError: the file exists, or cannot be written.
    """

    def __init__(self, path: Path, report: Callable[[str, str | None], None]):
        self.recording = Recording(path)
        self._report = report
        self._robot: RobotScene | None = None
        self._waiting: deque[tuple[str, Any]] = deque(maxlen=_MOST_WAITING)
        self._collector = StateCollector(lambda _: False)
        self._last_stamp = -1
        self._history: dict[int, Any] = {}  # progress of the last training by iteration
        self._policy: GaussianPolicy | None = None

    def show(self, topic: str, message: Any) -> None:
        """Draws a message of rclpy or of a bag, whose topic is one of `DRAWN`."""
        name = topic.rpartition("/")[2]
        if name == MJCF:
            self._draw(MJCF, partial(self._show_robot, message))
        elif self._robot is None:
            self._waiting.append((topic, message))
        elif name in TOPICS:
            if name in self.robot.states.sources and (found := self._collector.add(name, message)):
                self._draw(JOINTS, partial(self._show_state, found))
        elif name == "iterations":
            solver = topic.strip("/").rpartition("/")[0]
            self._draw(name, partial(self._show_solve, solver, message))
        else:
            self._draw(name, partial(getattr(self, f"_show_{name}"), message))

    def _draw(self, name: str, draw: Callable[[], None]) -> None:
        """Draws a message, and reports how that went."""
        try:
            draw()
        except InvalidInputError as error:
            self._report(name, f"Left out a {name}: {error}")
        else:
            self._report(name, None)

    def close(self) -> None:
        """Draws the last tubes and the learning curve, leaves out empty views, completes the file.

        Raises:
            UnfinishedRecordingError: the disk is full or does not respond.
        """
        if self._robot:
            self._robot.log_tubes()
        if self._history:
            # As a picture: a viewer has one timeline, and that of the robot has no iterations.
            history = [self._history[k] for k in sorted(self._history)]
            picture = io.BytesIO()
            learning_curve(result_from_msgs(history, self._policy)).savefig(picture, dpi=130)
            image = rr.EncodedImage(contents=picture.getvalue(), media_type="image/png")
            self.recording.log_static(LEARNING_CURVE, image)
        if self._robot:
            self._robot.lay_out(self.recording.logged)
        self.recording.close()

    @property
    def robot(self) -> RobotScene:
        """The robot, which is known once messages are drawn."""
        assert self._robot is not None
        return self._robot

    def _show_robot(self, message: Any) -> None:
        if self._robot is not None:
            return  # several nodes publish the same description
        self._robot = robot = RobotScene(self.recording, message.data)
        self._collector = StateCollector(robot.states.is_complete)
        while self._waiting:
            self.show(*self._waiting.popleft())

    def _show_state(self, messages: dict[str, Any]) -> None:
        states, joints = self.robot.states, messages[JOINTS]
        stamp, state = nanoseconds(joints.header.stamp), states.join(messages)
        tells_all = len(joints.effort) and not states.lacks_base(joints)
        efforts = efforts_from_msg(joints, states.joint_names) if tells_all else None
        if stamp == self._last_stamp:
            return  # the simulation repeats a state until its command comes
        if stamp < self._last_stamp:
            self.robot.restart_path()
        self._last_stamp = stamp
        self.robot.log_state(stamp, state, efforts)

    def _show_joint_command(self, message: Any) -> None:
        control = command_from_msg(message, self.robot.controls)
        self.robot.log_command(nanoseconds(message.header.stamp), control)

    def _show_joint_gains(self, message: Any) -> None:
        self.robot.close_loops(*gains_from_msg(message, self.robot.controls))

    def _show_context(self, message: Any) -> None:
        self.robot.log_context(nanoseconds(message.header.stamp), signals_from_msg(message))

    def _show_learning_progress(self, message: Any) -> None:
        self.recording.set_iteration(message.iteration, nanoseconds(message.header.stamp))
        for name, metric in METRICS.items():
            if metric.drawn and np.isfinite(value := getattr(message, name)):
                self.recording.log(f"learning/{metric.drawn}", rr.Scalars, scalars=[value])
        if message.iteration == 1:
            self._history.clear()
        if message.iteration in self._history or len(self._history) < _LONGEST:
            self._history[message.iteration] = message

    def _show_policy(self, message: Any) -> None:
        check_robot("it", message.robot, self.robot.told)
        policy = policy_from_msg(message)
        noise_std = policy.noise_std
        finite_array("policy.noise_std", noise_std, (len(self.robot.controls.names),))
        self._policy = policy
        self.recording.set_iteration(message.iteration, nanoseconds(message.header.stamp))
        noise = noise_std * np.abs(self.robot.controls.scale)
        self.recording.log("policy/noise_std", rr.Scalars, scalars=noise)

    def _show_trajectory_distribution(self, message: Any) -> None:
        check_robot("it", message.mean.robot, self.robot.told)
        q = distribution_from_msg(message)
        finite_array("mean.states[0]", q.mean.states[0], (len(self.robot.state_names),))
        n_dx, n_u = len(self.robot.deviation_names), len(self.robot.controls.names)
        finite_array("gains[0]", q.gains[0], (n_u, n_dx))
        time_step = positive("time_step", message.time_step)
        self.robot.keep_solution(int(message.trajectory_index), q, time_step)
        if message.iteration == 0:
            self.robot.log_initial_solution(int(message.trajectory_index), q.mean.states)

    def _show_plan(self, message: Any) -> None:
        check_robot("it", message.trajectory.robot, self.robot.told)
        states = trajectory_from_msg(message.trajectory).states
        finite_array("trajectory.states[0]", states[0], (len(self.robot.state_names),))
        stamp = nanoseconds(message.header.stamp)
        self.robot.log_plan(stamp, states, message.cost, message.solve_time)

    def _show_solve(self, solver: str, message: Any) -> None:
        self.recording.set_iteration(message.search_iteration, nanoseconds(message.header.stamp))
        self.recording.log(f"solves/{solver}", rr.Scalars, scalars=[message.cost])
