"""Node `visualizer`: a headless Rerun recording of the graph, live."""

from collections.abc import Callable
from pathlib import Path

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from vgps_msgs.msg import (
    GaussianPolicy,
    LearningProgress,
    OptimizerIteration,
    TrajectoryDistribution,
)

from vgps_ros.core.checks import finite_array, one_of
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Setting
from vgps_ros.messages.conversions import (
    command_from_msg,
    distribution_from_msg,
    nanoseconds,
    policy_from_msg,
    state_from_msg,
)
from vgps_ros.nodes.health import Health
from vgps_ros.nodes.parameters import TASK, declare
from vgps_ros.nodes.runner import run
from vgps_ros.tasks import make_task
from vgps_ros.views.robot_scene import RobotScene

OUTPUT = Setting("output", "run.rrd", "recording to write, which must not exist")

_STATE = "joint_states from simulation"
_DISCOVERY_PERIOD = 0.5  # between two looks for new optimizers [s]
# Deeper than the graph's own profiles: what comes while a message is drawn must not be lost.
_STREAM = QoSProfile(depth=1000)
_LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Visualizer(Node):
    """Shows what passes between the nodes; a message that does not fit is left out."""

    def __init__(self) -> None:
        super().__init__("visualizer")
        self._task = make_task(declare(self, TASK, read_only=True))
        path = Path(declare(self, OUTPUT, read_only=True))
        self._health = Health(self)
        self._scene = RobotScene(self._task, path)
        self._last_stamp = -1
        self._health.wait_for(_STATE)
        self.create_subscription(JointState, "joint_states", self._show_state, _STREAM)
        self.create_subscription(JointState, "joint_command", self._show_command, _STREAM)
        self.create_subscription(
            LearningProgress, "learning_progress", self._show_progress, _STREAM
        )
        self.create_subscription(GaussianPolicy, "policy", self._show_policy, _LATCHED)
        self.create_subscription(
            TrajectoryDistribution, "trajectory_distribution", self._show_solution, _LATCHED
        )
        self._solvers: set[str] = set()
        self.create_timer(
            _DISCOVERY_PERIOD, self._find_solvers, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self.get_logger().info(f"Recording what is seen to {path}.")

    def destroy_node(self) -> None:
        """Completes the recording."""
        self._scene.close()
        super().destroy_node()

    def _show_state(self, message: JointState) -> None:
        stamp = nanoseconds(message.header.stamp)
        try:
            state = state_from_msg(message, self._task.joint_names)
            known = len(message.effort) > 0
            efforts = command_from_msg(message, self._task.joint_names) if known else None
        except InvalidInputError as error:
            self._health.error(f"Left out a joint_states: {error}", "state")
            return
        self._health.arrived(_STATE)
        self._health.clear("state")
        if stamp == self._last_stamp:
            return  # the simulation repeats a state that waits for its command
        if stamp < self._last_stamp:
            self._scene.restart_path()
        self._last_stamp = stamp
        self._scene.log_state(stamp, state, efforts)

    def _show_command(self, message: JointState) -> None:
        try:
            torques = command_from_msg(message, self._task.actuated_joint_names)
        except InvalidInputError as error:
            self._health.error(f"Left out a joint_command: {error}", "command")
            return
        self._health.clear("command")
        self._scene.log_command(nanoseconds(message.header.stamp), torques)

    def _show_progress(self, message: LearningProgress) -> None:
        self._scene.log_progress(
            message.iteration,
            {
                "alpha": message.alpha,
                "stochastic_cost": message.stochastic_cost_mean,
                "deterministic_cost": message.deterministic_cost,
                "ddp_cost": message.ddp_cost,
                "initial_ddp_cost": message.initial_ddp_cost,
                "policy_kl": message.policy_kl,
            },
        )

    def _show_solution(self, message: TrajectoryDistribution) -> None:
        try:
            one_of("its task", message.task, [self._task.name])
            q = distribution_from_msg(message)
            finite_array("mean.states[0]", q.mean.states[0], (self._task.dynamics.state_dim,))
        except InvalidInputError as error:
            self._health.error(f"Left out a trajectory_distribution: {error}", "solution")
            return
        self._health.clear("solution")
        self._scene.keep_solution(message.trajectory_index, q)
        if message.iteration == 0:
            self._scene.log_initial_solution(message.trajectory_index, q.mean.states)

    def _show_policy(self, message: GaussianPolicy) -> None:
        try:
            one_of("its task", message.task, [self._task.name])
            noise_std = policy_from_msg(message).noise_std
        except InvalidInputError as error:
            self._health.error(f"Left out a policy: {error}", "policy")
            return
        self._health.clear("policy")
        self._scene.log_noise(message.iteration, noise_std)

    def _find_solvers(self) -> None:
        """Listens to every optimizer there is, whatever its name."""
        for topic, kinds in self.get_topic_names_and_types():
            if "vgps_msgs/msg/OptimizerIteration" in kinds and topic not in self._solvers:
                self._solvers.add(topic)
                show = self._show_solve(topic.rpartition("/")[0])
                self.create_subscription(OptimizerIteration, topic, show, _STREAM)

    def _show_solve(self, solver: str) -> Callable[[OptimizerIteration], None]:
        def show(message: OptimizerIteration) -> None:
            stamp = nanoseconds(message.header.stamp)
            self._scene.log_solver_iteration(stamp, solver, message.cost)

        return show


def main() -> None:
    """Runs the node."""
    run(Visualizer)
