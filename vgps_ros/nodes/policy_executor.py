"""Lifecycle node `policy_executor`: torques from the latest policy, for each state that comes."""

from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg

from vgps_ros.core.checks import one_of
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.execution import executed_control
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_file import load_policy
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Setting
from vgps_ros.messages.conversions import (
    command_to_msg,
    nanoseconds,
    pack,
    policy_from_msg,
    policy_to_msg,
    state_from_msg,
)
from vgps_ros.nodes.health import Health
from vgps_ros.nodes.parameters import SEED, TASK, declare, value
from vgps_ros.nodes.qos import LATCHED, NEWEST, STREAM
from vgps_ros.nodes.runner import run
from vgps_ros.tasks import make_task

STOCHASTIC = Setting("stochastic", False, "whether to add the policy's noise to its mean")
AUTOSTART = Setting("autostart", True, "whether to configure and activate at start")
POLICY_FILE = Setting(
    "policy_file", "", "policy.json of a training to start with; empty: wait for the topic policy"
)
COMMAND_TYPE = Setting(
    "command_type",
    "joint_state",
    "joint_state: sensor_msgs/JointState on joint_command, stamped with the state's time; "
    "float64_multi_array: std_msgs/Float64MultiArray on commands, as the effort controllers of "
    "ros2_control take it",
    choices=("joint_state", "float64_multi_array"),
)

_POLICY = "policy from policy_learner"
_STATE = "joint_states from simulation"


class PolicyExecutor(LifecycleNode):
    """Answers each state with torques, while it is active."""

    def __init__(self) -> None:
        super().__init__("policy_executor")
        self._task = make_task(declare(self, TASK, read_only=True))
        self._plain = declare(self, COMMAND_TYPE, read_only=True) == "float64_multi_array"
        declare(self, SEED)
        declare(self, STOCHASTIC)
        policy_file = declare(self, POLICY_FILE, read_only=True)
        autostart = declare(self, AUTOSTART, read_only=True)
        self._health = Health(self, owns="joint_command")
        self._active = False
        self._policy: GaussianPolicy | None = None
        # A policy that comes before activation is kept for it.
        self.create_subscription(GaussianPolicyMsg, "policy", self._take_policy, LATCHED)
        self.create_subscription(JointState, "joint_states", self._take_state, NEWEST)
        self._commands = (
            self.create_lifecycle_publisher(Float64MultiArray, "commands", STREAM)
            if self._plain
            else self.create_lifecycle_publisher(JointState, "joint_command", STREAM)
        )
        if policy_file:
            self._publish_policy(Path(policy_file))
        if autostart:
            self._health.when_alone(self._start)

    def _start(self) -> None:
        self.trigger_configure()
        self.trigger_activate()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lets torques flow."""
        self._active = True
        if self._policy is None:
            self._health.wait_for(_POLICY)
        self._health.wait_for(_STATE)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stops the torques."""
        self._active = False
        self._health.stop_waiting(_POLICY)
        self._health.stop_waiting(_STATE)
        self._health.clear("state")
        return super().on_deactivate(state)

    def _take_policy(self, message: GaussianPolicyMsg) -> None:
        try:
            policy = self._checked(policy_from_msg(message), message.task)
        except InvalidInputError as error:
            kept = "the one before stays" if self._policy else "there is none before it"
            self._health.error(f"Refused a policy, and {kept}: {error}", "policy")
            return
        self._policy = policy
        self._health.arrived(_POLICY)
        self._health.clear("policy")
        self._health.set_value("policy of iteration", message.iteration)

    def _publish_policy(self, path: Path) -> None:
        """Publishes the file's policy, for this node and whoever else follows the topic."""
        policy, task = load_policy(path)
        self._checked(policy, task)
        publisher = self.create_publisher(GaussianPolicyMsg, "policy", LATCHED)
        publisher.publish(policy_to_msg(policy, task, 0, self.get_clock().now().to_msg()))

    def _checked(self, policy: GaussianPolicy, task: str) -> GaussianPolicy:
        one_of("the policy's task", task, [self._task.name])
        policy.check_fits(self._task.dynamics.state_dim, self._task.dynamics.control_dim)
        return policy

    def _take_state(self, message: JointState) -> None:
        if not self._active:
            return
        self._health.arrived(_STATE)
        if self._policy is None:
            return
        try:
            state = state_from_msg(message, self._task.joint_names)
            torques = self._torques(self._policy, state, nanoseconds(message.header.stamp))
        except InvalidInputError as error:
            self._health.error(f"Gave no torques: {error}", "state")
            return
        self._health.clear("state")
        self._publish(torques, message.header.stamp)

    def _torques(self, policy: GaussianPolicy, state: Array, stamp: int) -> Array:
        if stamp < 0:
            raise InvalidInputError(
                f"the state's stamp is {stamp * 1e-9:g} s, but must not be < 0."
            )
        seed = value(self, SEED) if value(self, STOCHASTIC) else None
        torques = executed_control(policy, state, stamp, seed)
        if not np.isfinite(torques).all():
            raise InvalidInputError(f"the policy's output is {torques} in this state.")
        return torques

    def _publish(self, torques: Array, stamp: Time) -> None:
        self._commands.publish(
            Float64MultiArray(data=pack(torques))
            if self._plain
            else command_to_msg(torques, self._task.actuated_joint_names, stamp)
        )


def main() -> None:
    """Runs the node."""
    run(PolicyExecutor)
