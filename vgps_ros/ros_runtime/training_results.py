# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The policy and the trajectory distributions that a controller takes, from topics and files."""

from array import array
from dataclasses import replace
from pathlib import Path

from rclpy.node import Node
from std_msgs.msg import UInt8MultiArray
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg
from vgps_msgs.msg import TrajectoryDistribution as TrajectoryDistributionMsg

from vgps_ros.core.checks import one_of
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.core.settings import Setting
from vgps_ros.messages.conversions import (
    check_robot,
    distribution_from_msg,
    distribution_to_msg,
    policy_from_msg,
    policy_to_msg,
    robot_of,
)
from vgps_ros.messages.names import POLICY_OF_ITERATION
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.onnx_policy import OnnxPolicy
from vgps_ros.policies.policy_file import PolicyFile, open_policy
from vgps_ros.robot.deployment import Deployment
from vgps_ros.robot.executed_control import Driver, ExecutedPolicy
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import value
from vgps_ros.ros_runtime.qos import LATCHED, LATEST
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.storage.run_folder import load_distributions

POLICY_FILE = Setting(
    "policy_file",
    "",
    "policy.json of a training, or an ONNX file, to load at configure; empty: wait "
    "for the topic policy",
)
DISTRIBUTION_FILE = Setting(
    "distribution_file",
    "",
    "distribution.npz of a training, to load at configure, for distance_limit, distance_warning "
    "and feedback; empty: wait for the topic trajectory_distribution where they need it",
)
_POLICY = "policy from policy_learner"
_DISTRIBUTION = "trajectory_distribution from trajectory_optimizer"


class TrainingResults:
    """Takes policies and trajectory distributions; a wrong one is refused and the old one stays.

    What a file holds is published too, for the other nodes that follow the topic.

    Args:
        node: the node, which has declared POLICY_FILE and DISTRIBUTION_FILE.
        robot: what is known of the task that the results must be for.
        health: the node's diagnostics.
        needs_policy: whether the node waits for a policy, which may be a third-party ONNX policy.
        needs_distribution: whether the node waits for a distribution.

    Attributes:
        policy: the latest one, ready to drive, or None.
        observation: what it reads of a state.
        marginals: the training marginals by trajectory index.
        controls: what the robot's controls are, under the gains of a network in a file.

    Raises:
        InvalidInputError: a file that the node was started with is wrong.
    """

    def __init__(
        self,
        node: Node,
        robot: Deployment,
        health: Health,
        needs_policy: bool,
        needs_distribution: bool,
    ):
        self.policy: ExecutedPolicy | None = None
        self.observation = robot.observation
        self._node, self._robot, self._health = node, robot, health
        self.marginals: dict[int, TrainingMarginals] = {}
        self.controls = robot.controls
        self._needs_policy, self._waits_for_distribution = needs_policy, needs_distribution
        node.create_subscription(GaussianPolicyMsg, "policy", self._take_policy, LATCHED)
        if needs_distribution:
            topic, take = "trajectory_distribution", self._take_distribution
            node.create_subscription(TrajectoryDistributionMsg, topic, take, LATCHED)
        if policy_file := value(node, POLICY_FILE):
            self._publish_policy(Path(policy_file))
        if distribution_file := value(node, DISTRIBUTION_FILE):
            self._publish_distributions(Path(distribution_file))

    def wait(self) -> None:
        """Reports what is still missing; of a file it is on its way."""
        if self._needs_policy and self.policy is None and not value(self._node, POLICY_FILE):
            self._health.wait_for(_POLICY)
        if self._waits_for_distribution:
            self._health.wait_for(_DISTRIBUTION)

    def stop_waiting(self) -> None:
        """Reports that nothing is needed for now."""
        self._health.stop_waiting(_POLICY, _DISTRIBUTION)

    def _take_policy(self, message: GaussianPolicyMsg) -> None:
        kept = "the one before stays" if self.policy else "there is none before it"
        with self._health.judging("policy", f"Refused a policy, and {kept}"):
            one_of("the policy's task", message.task, [self._robot.name])
            check_robot("it", message.robot, robot_of(self._robot))
            if self.controls is not self._robot.controls:
                raise InvalidInputError(
                    "its controls are those of the task, but this node drives servos with the "
                    "gains of its policy_file; start another one."
                )
            file = PolicyFile("The policy", message.task, policy_from_msg(message))
            driver = driver_of(self._robot, file)
            if self._robot.observation.past and not self._needs_policy:
                raise InvalidInputError(
                    "it remembers former steps, of which a plan knows nothing; leave out "
                    "last_action and history of the task, or execute it by policy_executor."
                )
            self._drive_by(driver, message.iteration)

    def _drive_by(self, driver: Driver, iteration: int) -> None:
        self.policy, self.observation = ExecutedPolicy(driver.policy), driver.observation
        self._health.arrived(_POLICY)
        self._health.set_value(POLICY_OF_ITERATION, iteration)

    def _take_distribution(self, message: TrajectoryDistributionMsg) -> None:
        refusal = "Refused a trajectory_distribution; any before it stays"
        with self._health.judging("distribution", refusal):
            check_robot("it", message.mean.robot, robot_of(self._robot))
            self._prepare(message.trajectory_index, distribution_from_msg(message), message.task)

    def _publish_policy(self, path: Path) -> None:
        file = open_policy(path)
        if file.gaussian or file.task:
            one_of("the policy's task", file.task, [self._robot.name])
        driver = driver_of(self._robot, file)
        policy, controls = driver.policy, self.controls
        if isinstance(policy, OnnxPolicy) and policy.stiffness.any():
            controls = controls.with_servos(policy.stiffness, policy.damping)
            driver = driver_of(replace(self._robot, controls=controls), file)
        if file.gaussian:
            stamp = self._node.get_clock().now().to_msg()
            publisher = self._node.create_publisher(GaussianPolicyMsg, "policy", LATEST)
            publisher.publish(policy_to_msg(file.gaussian, file.task, 0, stamp))
        elif self._needs_policy:
            if controls is not self.controls and self._waits_for_distribution:
                raise InvalidInputError(
                    f"{file.name} drives servos, but a trajectory_distribution is about this "
                    "robot's motors; leave out distance_limit, distance_warning and "
                    "safe_action:=feedback."
                )
            self.controls = controls
            self._drive_by(driver, 0)
            # For a check of the bag. No node takes it: ONNX policies come from files alone.
            publisher = self._node.create_publisher(UInt8MultiArray, "onnx_policy", LATEST)
            publisher.publish(UInt8MultiArray(data=array("B", file.content)))
        else:
            raise InvalidInputError(
                f"{file.name} is a third-party ONNX policy, which only policy_executor can "
                "execute; name the policy.json of a run."
            )

    def _publish_distributions(self, path: Path) -> None:
        distributions, task = load_distributions(path)
        publisher = self._node.create_publisher(
            TrajectoryDistributionMsg, "trajectory_distribution", LATCHED
        )
        for index, q in enumerate(distributions):
            # Taken here too: the topic keeps the last few only.
            self._prepare(index, q, task)
            stamp = self._node.get_clock().now().to_msg()
            message = distribution_to_msg(q, self._robot, index, 0, stamp)
            message.mean.robot.digest = ""  # which the file does not tell
            publisher.publish(message)

    def _prepare(self, index: int, q: TrajectoryDistribution, task: str) -> None:
        """Hands on the marginals of the steps that a policy is trained on."""
        one_of("the distribution's task", task, [self._robot.name])
        trained, n_u = q.first(self._robot.horizon), len(self._robot.controls.names)
        observation = self._robot.observation
        told = self._robot.signals.spread(observation.told)
        self.marginals[index] = TrainingMarginals(trained, observation, n_u, told)
        self._waits_for_distribution = False
        self._health.arrived(_DISTRIBUTION)
