# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A lifecycle node that answers each state that comes with torques, as all controllers share it.

Where its law must not drive, the safe action does; `safety.supervisor` decides.
"""

import time
from abc import abstractmethod
from typing import Any

import numpy as np
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from vgps_ros.core.dynamics import CONTROL_BOUND
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Setting
from vgps_ros.messages.conversions import command_to_msg, nanoseconds, pack, stamp_of
from vgps_ros.messages.names import COMMANDS_SENT, IS_ACTIVE, SAFE_ACTION
from vgps_ros.messages.robot_state import JOINTS, StateMessages
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.learned_policy import DISTRIBUTION_FILE, POLICY_FILE, TrainingResults
from vgps_ros.ros_runtime.parameters import declare, declare_settings
from vgps_ros.ros_runtime.qos import NEWEST, NEWEST_OF_SENSORS, STREAM
from vgps_ros.ros_runtime.steady_timer import steady_timer
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.supervisor import Command, Supervisor
from vgps_ros.simulation.model import driven_velocities
from vgps_ros.tasks import make_task
from vgps_ros.tasks.settings import TASK

AUTOSTART = Setting("autostart", True, "whether to configure and activate at start")
COMMAND_TYPE = Setting(
    "command_type",
    "joint_state",
    "joint_state: sensor_msgs/JointState on joint_command, stamped with the state's time; "
    "float64_multi_array: std_msgs/Float64MultiArray on commands, as the effort controllers of "
    "ros2_control take it",
    choices=("joint_state", "float64_multi_array"),
)
STATE_QOS = Setting(
    "state_qos",
    "reliable",
    "reliable: no state is lost, as lock-step needs; sensor_data: best effort, which takes every "
    "driver of a real robot, whose states must have a stamp other than zero",
    choices=("reliable", "sensor_data"),
)
_PERIOD = 1.0  # over which figures are taken [s]


class Controller(LifecycleNode):
    """Answers each state with torques, while it is active.

    Args:
        name: name of the node.
        needs_policy: whether no state is answered before there is a policy.

    Attributes:
        task: the control problem.
        health: the node's diagnostics.
        training: the policy and the trajectory distributions of a training.
    """

    def __init__(self, name: str, *, needs_policy: bool):
        super().__init__(name)
        self.task = make_task(declare(self, TASK))
        self._needs_policy = needs_policy
        self._plain = declare(self, COMMAND_TYPE) == "float64_multi_array"
        self._is_real = declare(self, STATE_QOS) == "sensor_data"
        self.prepare_law()
        for setting in (POLICY_FILE, DISTRIBUTION_FILE):
            declare(self, setting)
        when_alone = self._start if declare(self, AUTOSTART) else lambda: None
        low, high = self.task.dynamics.control_limits
        limits = tuple(np.maximum(-low, high).clip(0.0, CONTROL_BOUND).tolist())
        self._settings = declare_settings(self, SafetySettings(torque_limits=limits))
        topic = "commands" if self._plain else "joint_command"
        self.health = Health(self, owns=(topic,), when_alone=when_alone)
        self._set_active(False)
        self._sent = 0
        self.health.set_value(COMMANDS_SENT, self._sent)  # for a check of the bag
        time_step = self.task.dynamics.time_step
        self._times = AnswerTimes(self.health, time_step)
        velocities = driven_velocities(self.task.dynamics.model)
        self._supervisor = Supervisor(
            self._settings,
            self._settings.torque_range((low, high)),
            velocities,
            time_step,
            self.task.limits.broken,
        )
        # A policy that comes before activation is kept for it.
        self.training = TrainingResults(
            self,
            self.task,
            self.health,
            self._supervisor.marginals.__setitem__ if self._settings.needs_distribution else None,
            needs_policy=needs_policy,
        )
        self._states = StateMessages(self.task.dynamics.model)
        also = " (and odom, if they lack the base)" * (self._states.sources != self._states.topics)
        self._awaited = f"{' and '.join(self._states.topics)}{also} from simulation"
        qos = NEWEST_OF_SENSORS if self._is_real else NEWEST
        self._states.subscribe(self.create_subscription, self._take_state, qos)
        kind = Float64MultiArray if self._plain else JointState
        self._commands = self.create_lifecycle_publisher(kind, topic, STREAM)
        self._watchdog = steady_timer(self, time_step, self._watch)
        self._watchdog.cancel()  # until there is an answer whose successor can be missed
        # With use_sim_time; the state of the time 0, which says so too, may be lost.
        self._clock_jumps = self.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            post_callback=lambda _: self._supervisor.forget_time(),
        )

    @abstractmethod
    def prepare_law(self) -> None:
        """Declares the parameters that only this controller has, and prepares its law."""

    @abstractmethod
    def law(self, state: Array, stamp: int) -> Array:
        """Returns the torques in a usable state, shape (n_u,), [N·m].

        Args:
            state: x, shape (n_x,).
            stamp: its stamp [ns].

        Raises:
            InvalidInputError: the law must not drive now; the safe action does.
        """

    def _start(self) -> None:
        self.trigger_configure()
        self.trigger_activate()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lets torques flow."""
        self._supervisor.begin()
        self._set_active(True)
        self.training.wait()
        self.health.wait_for(self._awaited)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stops the torques, also at the lifecycle's end and where a transition failed."""
        self.stop()
        return super().on_deactivate(state)

    on_shutdown = on_error = on_deactivate

    def stop(self) -> None:
        """Stops the torques: the last ones are zero, since motors may hold what they were sent."""
        if self._active:
            self._send(self._supervisor.stop())
        self._set_active(False)
        self._watchdog.cancel()
        self.training.stop_waiting()
        self.health.stop_waiting(self._awaited)
        self.health.clear("state", "distance")

    def _set_active(self, is_active: bool) -> None:
        self._active = is_active
        self.health.set_value(IS_ACTIVE, is_active)
        self.health.set_value(SAFE_ACTION, False)

    def _take_state(self, messages: dict[str, Any]) -> None:
        if not self._active:
            return
        self.health.arrived(self._awaited)
        if self._needs_policy and self.training.policy is None:
            return
        if self._watchdog.is_canceled():
            self._watchdog.reset()
        began = time.monotonic()
        try:
            command = self._answer(messages)
        except InvalidInputError as error:
            command = self._supervisor.refuse(str(error), time.monotonic())
        self._send(command)
        if command and not self._supervisor.fault:
            self._times.answered(command.stamp, time.monotonic() - began)
        self._report()

    def _answer(self, messages: dict[str, Any]) -> Command | None:
        state = self._states.join(messages)
        stamp = nanoseconds(messages[JOINTS].header.stamp)
        if self._is_real and stamp == 0:
            raise InvalidInputError(
                "the state's stamp is 0, but it must be the time of the measurement; let the "
                "robot's driver set it."
            )
        return self._supervisor.answer(
            state,
            stamp,
            lambda: (self.get_clock().now().nanoseconds - stamp) * 1e-9,
            time.monotonic(),
            lambda: self.law(state, stamp),
        )

    def _watch(self) -> None:
        """Sends the safe action where it is due without a state, once a control period."""
        if self._active and (command := self._supervisor.watch(time.monotonic())):
            self._send(command)
            self._report()

    def _send(self, command: Command | None) -> None:
        if command:
            self._sent += 1
            self.health.set_value(COMMANDS_SENT, self._sent)
            self._commands.publish(
                Float64MultiArray(data=pack(command.torques))
                if self._plain
                else command_to_msg(
                    command.torques, self.task.actuated_joint_names, stamp_of(command.stamp)
                )
            )

    def _report(self) -> None:
        """Shows on /diagnostics who drives, and why."""
        supervisor, settings = self._supervisor, self._settings
        self.health.set_value(SAFE_ACTION, supervisor.fault is not None)
        sentence = ""
        if supervisor.fault:
            sentence = f"Safe action active ({settings.safe_action}): {supervisor.fault}"
            if settings.recovery == "manual":
                sentence += " It stays until the node is deactivated and activated."
        self.health.report("state", error=sentence)
        self.health.report("distance", warning=supervisor.warning or "")
        if supervisor.distance is not None:
            self.health.set_value("distance from training", f"{supervisor.distance:.2f}")


class AnswerTimes:
    """Shows on /diagnostics how often a controller answers, how fast, and what it missed.

    The figures are those of ros2_control's controller_manager.

    A state is missed where the next one comes while an earlier one is still being answered: the
    stamps of the states that are answered then have a gap.

    Args:
        health: the node's diagnostics.
        period: the control period [s].
    """

    def __init__(self, health: Health, period: float):
        self._health = health
        self._period = round(period * 1e9)
        self._stamp: int | None = None
        self._missed = self._states = 0
        self._begin()

    def _begin(self) -> None:
        self._since, self._count, self._spent, self._longest = time.monotonic(), 0, 0.0, 0.0

    def answered(self, stamp: int, seconds: float) -> None:
        """Notes the stamp [ns] of a state that was answered, and the time that it took [s]."""
        gap = 0 if self._stamp is None else (stamp - self._stamp) // self._period - 1
        self._stamp = stamp
        self._missed += max(0, gap)
        self._states += 1 + max(0, gap)
        self._count += 1
        self._spent += seconds
        self._longest = max(self._longest, seconds)
        if (passed := time.monotonic() - self._since) > _PERIOD:
            mean, longest = 1e3 * self._spent / self._count, 1e3 * self._longest
            self._health.set_value("periodicity", f"{self._count / passed:.1f} Hz")
            self._health.set_value("execution time", f"mean {mean:.2f}, longest {longest:.2f} ms")
            self._health.set_value("missed deadlines", f"{self._missed} of {self._states}")
            self._begin()
