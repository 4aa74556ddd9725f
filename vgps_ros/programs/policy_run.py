# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A client of the simulation that runs it in lock-step and collects what its robot does."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from simulation_interfaces.msg import Result, SimulationState
from simulation_interfaces.srv import ResetSimulation, SetSimulationState, StepSimulation
from std_msgs.msg import UInt8MultiArray
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg
from vgps_msgs.msg import Signals as SignalsMsg

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.messages.conversions import (
    command_from_msg,
    nanoseconds,
    signals_from_msg,
    stamp_of,
    twist_to_msg,
)
from vgps_ros.messages.names import CMD_VEL, CONTEXT
from vgps_ros.messages.robot_state import JOINTS, StateMessages
from vgps_ros.policies.driver import for_policy
from vgps_ros.policies.policy_file import policy_of
from vgps_ros.ros_runtime.qos import LATCHED, STREAM
from vgps_ros.ros_runtime.runner import spin_once
from vgps_ros.simulation.frames import state_layout
from vgps_ros.tasks import Task
from vgps_ros.tasks.course import Course

# Steps asked for at once: fewer than a stream's queue is deep, so that no message is lost.
_STEPS_AT_ONCE = STREAM.depth // 2
_COMMAND_PERIOD = 0.1  # of a course, in simulated time [s]
_FAREWELL = 1.0  # longest wait until its last command has arrived [s]
_NO_EXECUTOR = "Is policy_executor running, active and with the same task?"


class PolicyRun(Node):
    """One run of the simulation, from a reset on.

    Anything that is missing is waited for up to the timeout [s]. A course is commanded by cmd_vel
    along the way.
    """

    def __init__(
        self,
        task: Task,
        simulation: str,
        timeout: float,
        namespace: str | None,
        course: Course | None = None,
    ):
        super().__init__("execute_policy", namespace=namespace)
        self._task, self._course = task, course
        self._timeout = timeout
        self._states: dict[int, Array] = {}  # by stamp [ns]
        self._commands: dict[int, JointState] = {}
        self._contexts: dict[int, Array] = {}
        self._policies: list[Any] = []
        # First, since nodes discover endpoints in their order: once a state comes, the simulation's
        # answers will come too.
        name = f"{simulation}/set_simulation_state"
        self._set_state = self.create_client(SetSimulationState, name)
        self._reset = self.create_client(ResetSimulation, f"{simulation}/reset_simulation")
        self._step = self.create_client(StepSimulation, f"{simulation}/step_simulation")
        self._messages = StateMessages(state_layout(task.dynamics.model))
        self._messages.subscribe(self.create_subscription, self._take_state, STREAM)
        self.create_subscription(JointState, "joint_command", self._take_command, STREAM)
        if task.signals.names:
            self.create_subscription(SignalsMsg, CONTEXT, self._take_context, STREAM)
        if course:
            self._cmd_vel = self.create_publisher(TwistStamped, CMD_VEL, 10)
        for kind, topic in ((GaussianPolicyMsg, "policy"), (UInt8MultiArray, "onnx_policy")):
            self.create_subscription(kind, topic, self._policies.append, LATCHED)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def execute(self, steps: int) -> Iterator[int]:
        """Resets the simulation and runs it, yielding the steps done; leaves it paused.

        Of a course, what is commanded changes between steps: it does not depend on how fast
        anything is. At the end all velocities are zero.

        Raises:
            VgpsError: the simulation or a policy does not come in time, or a step fails.
        """
        self._wait(
            lambda: self._step.service_is_ready() and self._states,
            "No simulation is there; start one with 'ros2 run vgps_ros simulation'.",
        )
        self._wait(
            lambda: self._policies,
            "No policy came on the topic policy; start policy_learner and train one.",
        )
        self._pause()
        self._states.clear()
        self._commands.clear()
        self._call(self._reset, ResetSimulation.Request())
        # The executor answers the reset's state, though nothing moves yet, and the first step may
        # take that answer. Once it is here, nothing from before the reset is on its way any more.
        self._wait(
            lambda: 0 in self._states and 0 in self._commands, f"No command came. {_NO_EXECUTOR}"
        )
        self._commands = {0: self._commands[0]}
        at_once, period = _STEPS_AT_ONCE, self._task.dynamics.time_step
        if self._course:
            at_once = max(1, round(_COMMAND_PERIOD / period))
        try:
            for done in range(0, steps, at_once):
                chunk = min(at_once, steps - done)
                self._command(done * period)
                self._call(self._step, StepSimulation.Request(steps=chunk))
                self._wait_for_messages(done + chunk)
                yield done + chunk
        finally:
            self._command(np.inf)
            if self._course:
                self._cmd_vel.wait_for_all_acked(Duration(seconds=_FAREWELL))

    def _command(self, time: float) -> None:
        """Publishes what the course has at a time [s]; it is zero after its end."""
        if self._course:
            stamp = stamp_of(self.get_clock().now().nanoseconds)
            self._cmd_vel.publish(twist_to_msg(self._course.at(time), stamp))

    def contexts(self, steps: int) -> Array:
        """Returns what the policy was told in the first steps, shape (steps, n_z)."""
        return np.array([self._contexts[self._stamp(t)] for t in range(steps)])

    def trajectory(self, steps: int) -> Trajectory:
        """Returns what the robot did in the first steps."""
        controls = self._with_loops().controls
        stamps = [self._stamp(t) for t in range(steps + 1)]
        return Trajectory(
            np.stack([self._states[stamp] for stamp in stamps]),
            np.stack([command_from_msg(self._commands[s], controls) for s in stamps[:-1]]),
        )

    def _with_loops(self) -> Task:
        """Returns the task in whose robot the loops of an ONNX policy's gains are closed."""
        content = getattr(self._policies[-1], "data", None)
        if content is None:
            return self._task
        return for_policy(self._task, policy_of(bytes(content), "The message on onnx_policy"))

    def _stamp(self, step: int) -> int:
        return round(step * self._task.dynamics.time_step * 1e9)

    def _take_state(self, messages: dict[str, Any]) -> None:
        stamp = nanoseconds(messages[JOINTS].header.stamp)
        self._states[stamp] = self._messages.join(messages)

    def _take_command(self, message: JointState) -> None:
        self._commands[nanoseconds(message.header.stamp)] = message

    def _take_context(self, message: SignalsMsg) -> None:
        values = np.array(list(signals_from_msg(message).values()))
        self._contexts[nanoseconds(message.header.stamp)] = values

    def _wait_for_messages(self, steps: int) -> None:
        """Waits for all states and commands of the steps so far."""
        first = max(0, steps - _STEPS_AT_ONCE)
        states = {self._stamp(t) for t in range(first, steps + 1)}
        answered = {self._stamp(t) for t in range(first, steps)}
        answers = (self._commands, *([self._contexts] if self._task.signals.names else []))
        self._wait(
            lambda: (
                states <= self._states.keys() and all(answered <= each.keys() for each in answers)
            ),
            f"A message on {', '.join(self._messages.topics)} or joint_command was lost; is "
            "another node driving them?",
        )

    def _pause(self) -> None:
        """Pauses the simulation; one that is stopped has to play first."""
        playing, paused = (
            SetSimulationState.Request(state=SimulationState(state=state))
            for state in (SimulationState.STATE_PLAYING, SimulationState.STATE_PAUSED)
        )
        codes = SetSimulationState.Response
        outcomes = (codes.ALREADY_IN_TARGET_STATE, codes.INCORRECT_TRANSITION)
        if self._call(self._set_state, paused, outcomes) == codes.INCORRECT_TRANSITION:
            self._call(self._set_state, playing)
            self._call(self._set_state, paused)

    def _call(self, client: Client, request: Any, also: tuple[int, ...] = ()) -> int:
        """Returns the outcome, RESULT_OK or one of those that may be, too."""
        future = client.call_async(request)
        self._wait(future.done, f"{client.srv_name} did not answer. {_NO_EXECUTOR}")
        result = future.result().result
        if result.result not in (Result.RESULT_OK, *also):
            raise VgpsError(f"{client.srv_name} failed: {result.error_message}")
        return int(result.result)

    def _wait(self, condition: Callable[[], Any], sentence: str) -> None:
        end = time.monotonic() + self._timeout
        while not condition():
            if time.monotonic() > end:
                raise VgpsError(f"Waited {self._timeout:g} s. {sentence}")
            spin_once(self._executor, 0.1)
