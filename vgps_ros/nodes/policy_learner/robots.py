# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Does the rollouts of a training on robots that are topics and services, in lock-step.

Each robot lives under a namespace, and speaks as the node `simulation` does: its parameter
`initial_state` and a reset put it at a start, and each of its states waits for the command of the
same stamp. The search does not know: it has a task whose dynamics do their rollouts there.
"""

import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import ResetSimulation, SetSimulationState

from vgps_ros.core.dynamics import ControlLaw
from vgps_ros.core.errors import VgpsError
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Range, Setting
from vgps_ros.messages.conversions import command_to_msg, nanoseconds
from vgps_ros.messages.robot_state import JOINTS, StateMessages
from vgps_ros.nodes.policy_learner.optimizer_pool import CancelledError
from vgps_ros.robot.controls import CONTROL_BOUND
from vgps_ros.robot.executed_control import ExactMean
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import value
from vgps_ros.ros_runtime.qos import CALLS, LEASE, STATES
from vgps_ros.ros_runtime.runner import streaming_executor
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.tasks import Task

ROLLOUT_ROBOTS = Setting(
    "rollout_robots",
    ("",),
    "namespaces of the robots that share the rollouts of mdgps with "
    "mirror.dynamics fitted, such as robot_1, in each of which a simulation "
    "waits in lock-step; '' alone: this process simulates them",
)
ROLLOUT_TIMEOUT = Setting(
    "rollout_timeout",
    60.0,
    Range(0.0, 1e6),
    "time without a step of any robot after which a training fails [s]; 0: it waits for ever",
)

_POLL = 0.1  # longest wait for a message [s]
_ANSWER_TIMEOUT = 1.0  # after which a call is made again: its answer may have been lost [s]
_NEAR = 1e-6  # a robot's state to the start at which it was put: messages may round

# Maps the step, the rollout and the states so far, shape (T+1, N, n_x), to a control, (n_u,).
_Law = Callable[[int, int, Array], Array]
_Waiting = Generator[None, None, Any]


class _RobotDynamics(Dynamics):
    """A model's dynamics, but rollouts are those of robots."""

    def __init__(self, model: Dynamics, robots: "Robots"):
        vars(self).update(vars(model))
        self._robots = robots

    def rollouts(
        self, initial_states: Array, control_law: ControlLaw, horizon: int
    ) -> tuple[Array, Array, int]:
        """Runs rollouts of a law that depends on nothing but the step and the states."""
        shape = len(initial_states), self.control_dim

        def law(t: int, i: int, states: Array) -> Array:
            # Of all rollouts, since BLAS rounds by the number of rows.
            controls = control_law(t, np.nan_to_num(states[t]))
            return np.asarray(np.broadcast_to(controls, shape)[i])

        return self._robots.roll_out(initial_states, law, horizon)

    def execute(
        self,
        policy: GaussianPolicy,
        observation: Observation,
        initial_states: Array,
        noise: Array,
        **others: Any,
    ) -> tuple[Array, Array]:
        """Runs rollouts of a policy, which reads no state too late or with noise."""
        assert not others
        policy.check_fits(observation.names, self.control_dim)
        mean, (n, horizon, _) = ExactMean(policy), noise.shape
        context = observation.context
        context = np.empty((horizon, 0)) if context is None else context
        told = np.broadcast_to(context, (n, *context.shape[-2:]))

        def law(t: int, i: int, states: Array) -> Array:
            return mean(observation.within(told[i, t])(states[t, i])) + noise[i, t]

        states, controls, _ = self._robots.roll_out(initial_states, law, horizon)
        return states, controls


class Robots:
    """Gives each idle robot the next rollout; what they do does not depend on who did it.

    A rollout whose robot was killed or hangs is done again by another one, or by the same one once
    it is back. The learner has declared ROLLOUT_ROBOTS and ROLLOUT_TIMEOUT.

    Attributes:
        task: the task on these robots.
        is_cancelled: tells whether nobody wants the rollouts any more.
    """

    def __init__(self, learner: Node, names: Sequence[str], task: Task, health: Health):
        self.task = replace(task, dynamics=_RobotDynamics(task.dynamics, self))
        self.is_cancelled: Callable[[], bool] = lambda: False
        self._learner, self._health = learner, health
        # A node of its own, which runs in the thread of the search: messages then wake no other.
        self._node = Node(
            f"{learner.get_name()}_robots",
            namespace=learner.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._robots = [_Robot(self._node, name, task) for name in names]
        self._executor = streaming_executor()
        self._executor.add_node(self._node)

    def close(self) -> None:
        """Leaves the graph."""
        self._executor.shutdown()
        self._node.destroy_node()

    def roll_out(self, starts: Array, law: _Law, horizon: int) -> tuple[Array, Array, int]:
        """Runs a rollout from each start (N, n_x), with controls within their limits.

        A rollout that diverges is NaN from the step after which it did.

        Returns:
            States, shape (N, T+1, n_x), controls, shape (N, T, n_u), and how many simulator steps
            they took.

        Raises:
            CancelledError: nobody wants them any more.
            VgpsError: no robot is there for too long, or one cannot be used.
        """
        n, dynamics = len(starts), self.task.dynamics
        states = np.full((horizon + 1, n, dynamics.state_dim), np.nan)
        controls = np.full((horizon, n, dynamics.control_dim), np.nan)
        waiting, began = deque(range(n)), time.monotonic()
        try:
            while waiting or any(robot.work for robot in self._robots):
                with suppress(ExternalShutdownException):  # by which the training is cancelled
                    self._executor.spin_once(timeout_sec=_POLL)
                if self.is_cancelled():
                    raise CancelledError("The training was cancelled.")
                for robot in self._robots:
                    if robot.work and next(robot.work, "done"):
                        robot.work = None
                    elif robot.work and robot.is_lost:
                        waiting.appendleft(robot.give_back())
                        sentence = f"{robot.name} is lost with a rollout, which is done again."
                        self._learner.get_logger().warning(sentence)
                    if waiting and not robot.work:
                        if robot.is_lost:
                            self._health.wait_for(robot.awaited)
                        else:
                            self._health.arrived(robot.awaited)
                            self._health.report(robot.name, warning=robot.rivals)
                            i = waiting.popleft()
                            states[:, i] = controls[:, i] = np.nan
                            robot.begin(i, starts[i], law, states, controls)
                self._check_progress(began)
        finally:
            for robot in self._robots:
                robot.give_back()
        executed = (np.abs(controls) < CONTROL_BOUND).all(axis=2).sum()
        states, controls = (np.ascontiguousarray(a.swapaxes(0, 1)) for a in (states, controls))
        return states, controls, int(executed) * dynamics.substeps

    def _check_progress(self, began: float) -> None:
        timeout = value(self._learner, ROLLOUT_TIMEOUT)
        moved = max(began, *(robot.moved for robot in self._robots))
        if timeout and time.monotonic() - moved > timeout:
            names = ", ".join(robot.name for robot in self._robots)
            raise VgpsError(
                f"None of the robots {names} did a step for {timeout:g} s: start "
                "a simulation in lock-step in the namespace of each, and train again; where "
                "checkpoint_folder is set, that goes on after the last whole iteration."
            )


class _Robot:
    """A robot, and the rollout that it does.

    Attributes:
        name: its namespace.
        awaited: what the learner waits for where it is lost.
        work: what it still has to do of a rollout; it yields where it has to wait.
        moved: when it did its last step, by the steady clock [s].
    """

    def __init__(self, node: Node, name: str, task: Task):
        self._node, self._task = node, task
        self.name = node.resolve_topic_name(f"{name}/joint_command").rpartition("/")[0]
        self.awaited = f"the states of {self.name}"
        self.work: _Waiting | None = None
        self.moved = self._heard = -np.inf
        self._rollout, self._messages = -1, dict[str, Any]()
        # First, since nodes discover endpoints in their order: after a state come answers too.
        self._start, self._reset, self._play = (
            node.create_client(kind, f"{self.name}/simulation/{service}", qos_profile=CALLS)
            for kind, service in (
                (SetParameters, "set_parameters"),
                (ResetSimulation, "reset_simulation"),
                (SetSimulationState, "set_simulation_state"),
            )
        )
        self._commands = node.create_publisher(JointState, f"{self.name}/joint_command", STATES)
        self._states = StateMessages(task.deployment.layout)

        def subscribe(kind: Any, topic: str, take: Callable[[Any], None], qos: Any) -> None:
            node.create_subscription(kind, f"{self.name}/{topic}", take, qos)

        self._states.subscribe(subscribe, self._take, STATES)

    def _take(self, messages: dict[str, Any]) -> None:
        self._messages, self._heard = messages, time.monotonic()

    @property
    def is_lost(self) -> bool:
        """Whether nothing was heard of it for a while; a robot that waits repeats its state."""
        return time.monotonic() - self._heard > LEASE

    @property
    def rivals(self) -> str:
        """A sentence on others that command the robot; empty where the learner is alone."""
        senders = self._node.get_publishers_info_by_topic(f"{self.name}/joint_command")
        if len(senders) < 2:
            return ""
        names = ", ".join(sorted(info.node_name for info in senders))
        return f"{names} command {self.name}, but the learner must be alone: end the others."

    def begin(self, i: int, start: Array, law: _Law, states: Array, controls: Array) -> None:
        """Begins rollout i, whose states (T+1, N, n_x) and controls (T, N, n_u) are written."""
        self._rollout, self.work = i, self._rolled_out(i, start, law, states, controls)

    def give_back(self) -> int:
        """Gives up the rollout, and returns its number."""
        if self.work:
            self.work.close()
        self.work = None
        return self._rollout

    def _rolled_out(
        self, i: int, start: Array, law: _Law, states: Array, controls: Array
    ) -> _Waiting:
        """Puts the robot at the start and answers its states."""
        parameter = Parameter("initial_state", value=start.tolist()).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        (taken,) = (yield from self._ask(self._start, request)).results
        if not taken.successful:
            raise VgpsError(
                f"{self.name} cannot start where the task does ({taken.reason}): start its "
                "simulation with the learner's task."
            )
        yield from self._ask(self._reset, ResetSimulation.Request())
        yield from self._plays()
        t, command, (low, high) = 0, JointState(), self._task.dynamics.control_limits
        while True:
            if not (messages := self._messages):
                yield
                continue
            self._messages, stamp = {}, messages[JOINTS].header.stamp
            step = round(nanoseconds(stamp) * 1e-9 / self._task.dynamics.time_step)
            x = self._states.join(messages)
            if step == t and (t or np.allclose(x, start, rtol=_NEAR, atol=_NEAR)):
                states[t, i], self.moved = x, time.monotonic()
                if t == len(controls):
                    return
                control = np.asarray(np.clip(law(t, i, states), low, high))
                controls[t, i] = control
                if not (np.abs(control) < CONTROL_BOUND).all():
                    return
                command = command_to_msg(control, self._task.controls, stamp)
                self._commands.publish(command)
                t += 1
            elif t and step == t - 1:  # the command was lost, or it is paused, or cannot go on
                if not (yield from self._plays()):
                    return
                self._commands.publish(command)
            elif t and step > t:
                raise VgpsError(
                    f"{self.name} did not wait for the command that answers its state: start its "
                    "simulation with mode:=lock_step, and train again."
                )
            elif t:  # it was started again, or another client has reset it
                self._heard = -np.inf

    def _plays(self) -> _Waiting:
        """Lets the robot play; returns false where its state has diverged."""
        playing = SimulationState(state=SimulationState.STATE_PLAYING)
        answer = yield from self._ask(self._play, SetSimulationState.Request(state=playing))
        return answer.result.result != SetSimulationState.Response.STATE_TRANSITION_ERROR

    def _ask(self, client: Client, request: Any) -> _Waiting:
        """Calls a service until it answers, and returns the answer."""
        while True:
            future, end = client.call_async(request), time.monotonic() + _ANSWER_TIMEOUT
            try:
                while not future.done() and time.monotonic() < end:
                    yield
            finally:
                client.remove_pending_request(future)
            if future.done():
                return future.result()
