"""Lifecycle node `policy_executor`: torques from the latest policy, for each state that comes.

Where the policy must not drive, the safe action does; `core.safety` decides.
"""

import time
from typing import Any

from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from vgps_ros.core.checks import finite_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy, executed_control
from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Setting
from vgps_ros.messages.conversions import command_to_msg, nanoseconds, pack, stamp_of
from vgps_ros.messages.robot_state import JOINTS, StateMessages
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.learned_policy import DISTRIBUTION_FILE, POLICY_FILE, TrainingResults
from vgps_ros.ros_runtime.parameters import declare, declare_settings, value
from vgps_ros.ros_runtime.qos import NEWEST, NEWEST_OF_SENSORS, STREAM
from vgps_ros.ros_runtime.rclpy_internals import streaming_executor
from vgps_ros.ros_runtime.runner import run
from vgps_ros.ros_runtime.state_subscription import subscribe_to_states
from vgps_ros.ros_runtime.steady_timer import steady_timer
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.supervisor import Command, Supervisor
from vgps_ros.simulation.model import driven_velocities, model_torque_limits
from vgps_ros.tasks import make_task
from vgps_ros.tasks.settings import TASK

STOCHASTIC = Setting("stochastic", False, "whether to add the policy's noise to its mean")
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


class PolicyExecutor(LifecycleNode):
    """Answers each state with torques, while it is active."""

    def __init__(self) -> None:
        super().__init__("policy_executor")
        self._task = make_task(declare(self, TASK))
        self._plain = declare(self, COMMAND_TYPE) == "float64_multi_array"
        self._is_real = declare(self, STATE_QOS) == "sensor_data"
        for setting in (SEED, STOCHASTIC):
            declare(self, setting, may_change=True)
        for setting in (POLICY_FILE, DISTRIBUTION_FILE):
            declare(self, setting)
        when_alone = self._start if declare(self, AUTOSTART) else lambda: None
        limits = tuple(model_torque_limits(self._task.dynamics.model).tolist())
        self._settings = declare_settings(self, SafetySettings(torque_limits=limits))
        control_dim = self._task.dynamics.control_dim
        finite_array("torque_limits", self._settings.torque_limits, (control_dim,))
        topic = "commands" if self._plain else "joint_command"
        self._health = Health(self, owns=(topic,), when_alone=when_alone)
        self._active = False
        time_step = self._task.dynamics.time_step
        velocities = driven_velocities(self._task.dynamics.model)
        self._supervisor = Supervisor(
            self._settings, velocities, time_step, self._task.limits.broken
        )
        # A policy that comes before activation is kept for it.
        self._training = TrainingResults(
            self,
            self._task,
            self._health,
            self._supervisor.marginals.__setitem__ if self._settings.needs_distribution else None,
        )
        self._states = StateMessages(self._task.dynamics.model)
        self._awaited = f"{' and '.join(self._states.topics)} from simulation"
        qos = NEWEST_OF_SENSORS if self._is_real else NEWEST
        subscribe_to_states(self, self._states, self._take_state, qos)
        kind = Float64MultiArray if self._plain else JointState
        self._commands = self.create_lifecycle_publisher(kind, topic, STREAM)
        self._watchdog = steady_timer(self, time_step, self._watch)
        self._watchdog.cancel()  # until there is an answer whose successor can be missed
        # With use_sim_time; the state of the time 0, which says so too, may be lost.
        self._clock_jumps = self.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            post_callback=lambda _: self._supervisor.forget_time(),
        )

    def _start(self) -> None:
        self.trigger_configure()
        self.trigger_activate()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lets torques flow."""
        self._supervisor.begin()
        self._active = True
        self._training.wait()
        self._health.wait_for(self._awaited)
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
        self._active = False
        self._watchdog.cancel()
        self._training.stop_waiting()
        self._health.stop_waiting(self._awaited)
        self._health.clear("state", "distance")

    def _take_state(self, messages: dict[str, Any]) -> None:
        if not self._active:
            return
        self._health.arrived(self._awaited)
        policy = self._training.policy
        if policy is None:
            return
        if self._watchdog.is_canceled():
            self._watchdog.reset()
        try:
            command = self._answer(policy, messages)
        except InvalidInputError as error:
            command = self._supervisor.refuse(str(error), time.monotonic())
        self._send(command)
        self._report()

    def _answer(self, policy: GaussianPolicy, messages: dict[str, Any]) -> Command | None:
        state = self._states.join(messages)
        stamp = nanoseconds(messages[JOINTS].header.stamp)
        if self._is_real and stamp == 0:
            raise InvalidInputError(
                "the state's stamp is 0, but it must be the time of the measurement; let the "
                "robot's driver set it."
            )
        seed = value(self, SEED) if value(self, STOCHASTIC) else None
        return self._supervisor.answer(
            state,
            stamp,
            lambda: (self.get_clock().now().nanoseconds - stamp) * 1e-9,
            time.monotonic(),
            lambda: executed_control(policy, self._task.observation(state), stamp, seed),
        )

    def _watch(self) -> None:
        """Sends the safe action where it is due without a state, once a control period."""
        if self._active and (command := self._supervisor.watch(time.monotonic())):
            self._send(command)
            self._report()

    def _send(self, command: Command | None) -> None:
        if command:
            self._commands.publish(
                Float64MultiArray(data=pack(command.torques))
                if self._plain
                else command_to_msg(
                    command.torques, self._task.actuated_joint_names, stamp_of(command.stamp)
                )
            )

    def _report(self) -> None:
        """Shows on /diagnostics who drives, and why."""
        supervisor, settings = self._supervisor, self._settings
        sentence = ""
        if supervisor.fault:
            sentence = (
                f"Not the policy drives, but the safe action ({settings.safe_action}): "
                f"{supervisor.fault}"
            )
            if settings.recovery == "manual":
                sentence += " It stays until the node is deactivated and activated."
        self._health.report("state", error=sentence)
        self._health.report("distance", warning=supervisor.warning or "")
        if supervisor.distance is not None:
            self._health.set_value("distance from training", f"{supervisor.distance:.2f}")


def main() -> int:
    """Runs the node; returns the exit code."""
    return run(PolicyExecutor, streaming_executor, close=lambda node, _: node.stop())
