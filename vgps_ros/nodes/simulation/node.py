# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `simulation`: a task's robot in MuJoCo, in lock-step with its controller or in real time.

In lock-step each state waits for the command that carries its stamp, so a run does not depend on
how fast anything is. A state that stays unanswered is sent again each second: a controller may come
late, and must answer the same state in the same way. Steps that a client asked for and waits for
end after `wait_timeout` without a command.
"""

import time
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMsg
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from vgps_msgs.msg import Signals as SignalsMsg

from vgps_ros.core.checks import finite_array
from vgps_ros.core.dynamics import DIVERGENCE_BOUND
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Range, Setting
from vgps_ros.messages.conversions import (
    command_from_msg,
    gains_from_msg,
    nanoseconds,
    stamp_of,
    wrench_from_msg,
)
from vgps_ros.messages.names import GAINS, MJCF, URDF
from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.nodes.simulation.frames import FrameBroadcaster
from vgps_ros.nodes.simulation.imu import SimulatedImu
from vgps_ros.nodes.simulation.robot import SimulatedRobot
from vgps_ros.nodes.simulation.services import RunControl, SimulationServices
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare, declare_settings, value
from vgps_ros.ros_runtime.qos import LATEST, STATES, lively
from vgps_ros.ros_runtime.runner import Runnable, streaming_executor
from vgps_ros.ros_runtime.services import steady_timer
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.urdf import urdf
from vgps_ros.simulation.warnings import in_words
from vgps_ros.tasks import make_task
from vgps_ros.tasks.disturbed_task import with_servos
from vgps_ros.tasks.registry import TASK

COMMAND_TIMEOUT = Setting(
    "command_timeout",
    0.5,
    Range(0.01, 86400.0),
    "in real_time mode, the robot is left alone after this time without a "
    "command: torques are zero, and servos hold their positions; a command that "
    "answers an older state is refused [s of the wall clock]",
)
PUSH_DURATION = Setting(
    "push_duration",
    0.1,
    Range(0.0, 3600.0),
    "simulated time for which a push acts, unless another one comes before [s]",
)

_COMMAND = "joint_command from policy_executor"
_OLDEST_COMMAND = 10  # control steps for which a command may be held before that is an error
_FIGURE_PERIOD = 1.0  # over which figures are taken [s]
_REPEAT_PERIOD = 1.0  # between two copies of a state that does not change [s]


@dataclass(frozen=True)
class _SimulationSettings:
    """Settings that stay as long as the simulation runs."""

    mode: Annotated[
        Literal["lock_step", "real_time"],
        "lock_step waits for the command that answers a state; real_time follows the wall clock",
    ] = "lock_step"
    real_time_factor: Annotated[
        float,
        Range(0.01, 100.0),
        "simulated seconds per second of the wall clock, in real_time mode",
    ] = 1.0
    start_paused: Annotated[bool, "whether to wait for a service call before moving"] = False


class SimulationNode(Node):
    """Publishes states and the clock, takes commands, and does what its services say."""

    def __init__(self) -> None:
        super().__init__("simulation")
        self._task = self._motors = make_task(declare(self, TASK))
        self._messages = StateMessages(state_layout(self._task.dynamics.model))
        self._initial_state = Setting(
            "initial_state",
            tuple(self._task.initial_state.tolist()),
            Range(-DIVERGENCE_BOUND, DIVERGENCE_BOUND),
            "positions, velocities and activations, in MuJoCo's order, at "
            "the next reset [m, rad, m/s, rad/s]",
        )
        start = declare(self, self._initial_state, may_change=True, also_check=self._to_state)
        settings = declare_settings(self, _SimulationSettings())
        self._lock_step = settings.mode == "lock_step"
        self._factor = factor = settings.real_time_factor
        declare(self, COMMAND_TIMEOUT, may_change=True)
        declare(self, PUSH_DURATION, may_change=True)
        self.control = RunControl(paused=settings.start_paused)
        model = self._task.dynamics.model
        self._frames = FrameBroadcaster(self, model)
        self._imu = SimulatedImu(self, self._messages, model.opt.gravity)
        self._health = Health(self, owns=("joint_states", "/clock", *self._frames.topics))
        self._command_age = _CommandAge(self._health)
        self.robot = SimulatedRobot(self._task, self._messages, self._to_state(start))
        self._warned = self._task.dynamics.warnings()
        self._held_stamp = 0  # of the state that the held command answers [ns]
        self._seen_stamp = -1  # of the state at the last look, once a second

        self._states = {
            topic: self.create_publisher(kind, topic, lively(STATES))
            for topic, kind in self._messages.topics.items()
        }
        self._clocks = self.create_publisher(ClockMsg, "/clock", lively(STATES))
        self.create_subscription(JointState, "joint_command", self._take_command, STATES)
        self.create_subscription(SignalsMsg, GAINS, self._take_gains, LATEST)
        self.create_subscription(WrenchStamped, "push", self._take_push, STATES)
        SimulationServices(self, self._task)
        # The node's own time is what it publishes; its timers follow the wall clock.
        steady_timer(self, _REPEAT_PERIOD, self._repeat)
        time_step = self._task.dynamics.time_step
        if not self._lock_step:
            steady_timer(self, time_step / factor, self._step_in_real_time)
        timing = "lock-step" if self._lock_step else f"real time, factor {factor:g}"
        self.get_logger().info(
            f"Simulating the {self._task.name} at {1 / time_step:g} Hz, {timing}."
        )
        for topic, text in ((MJCF, self._task.mjcf), (URDF, urdf(model))):
            self.create_publisher(String, topic, LATEST).publish(String(data=text))
        self.begin()

    def _to_state(self, values: tuple[float, ...]) -> Array:
        """Returns the state; joining its messages checks that its quaternions are rotations."""
        state = finite_array("initial_state", values, (self._task.dims["n_x"],))
        self._messages.join(self._messages.split(state, stamp_of(0)))
        return state

    def _publish(self) -> None:
        self._clocks.publish(ClockMsg(clock=stamp_of(self.robot.stamp)))
        self._imu.send(self.robot)
        for topic, message in self.robot.messages.items():
            self._states[topic].publish(message)
        self._frames.send(self.robot.state, self.robot.stamp)  # while the controller computes

    def _advance(self, command: Array) -> None:
        try:
            self.robot.advance(command)
        except DivergenceError as error:
            self._report_warnings()
            self._health.report("state", error=str(error))
            self.control.fail(str(error))
            return
        self._publish()
        self.control.step_done()
        self._report_warnings()

    def _report_warnings(self) -> None:
        new = self._task.dynamics.warnings() - self._warned
        if new:
            self._warned += new
            self._health.set_value("MuJoCo warnings", in_words(self._warned))
            sentence = (
                f"MuJoCo warns of {in_words(new)} at {self.robot.stamp * 1e-9:g} s: the motion "
                "may be wrong from here; check the commands, and reset the simulation."
            )
            self._health.report("simulator", warning=sentence)

    # Commands

    def _take_command(self, message: JointState) -> None:
        stamp = nanoseconds(message.header.stamp)
        oldest = self.robot.stamp  # of a state that may still be answered [ns]
        if not self._lock_step:
            timeout = round(value(self, COMMAND_TIMEOUT) * self._factor * 1e9)
            oldest = max(self._held_stamp, self.robot.stamp - timeout)
        in_time = oldest <= stamp <= self.robot.stamp
        if not in_time and stamp == self.robot.previous_stamp:
            return  # the second answer to a state that was sent twice
        try:
            command = command_from_msg(message, self._task.controls)
            self.robot.check(command)
            if not in_time:
                raise InvalidInputError(
                    f"its stamp is {stamp * 1e-9:g} s, but it must be that of the state that it "
                    f"answers, now {self.robot.stamp * 1e-9:g} s."
                )
        except InvalidInputError as error:
            self._health.report("command", error=f"Ignored a joint_command: {error}")
            return
        self._health.arrived(_COMMAND)
        self._health.clear("command")
        if not self._lock_step:
            self._held, self._held_stamp, self._held_since = command, stamp, time.monotonic()
            self._is_left_alone = False
        elif self.control.running:
            self._advance(command)

    def _take_gains(self, message: SignalsMsg) -> None:
        """Lets the joints close loops of positions, at the rate of the simulator."""
        own = self._task.controls
        with self._health.judging("gains", f"Ignored {GAINS}"):
            gains = gains_from_msg(message, own)
            if np.array_equal(gains, (own.stiffness, own.damping)):
                return
            self._task = with_servos(self._motors, *gains)
            self._warned = self._task.dynamics.warnings()
            self.robot.close_loops(self._task)
            self._held, self._is_left_alone = self.robot.resting(), True
            self.get_logger().info(f"The controls are {self._task.controls.label()} now.")

    def _take_push(self, message: WrenchStamped) -> None:
        with self._health.judging("push", "Ignored a push"):
            wrench = wrench_from_msg(message.wrench)
            self.robot.push(message.header.frame_id, wrench, value(self, PUSH_DURATION))

    def _step_in_real_time(self) -> None:
        if not self.control.running:
            return
        timeout = value(self, COMMAND_TIMEOUT)
        if np.isnan(self._held_since):
            self._health.wait_for(_COMMAND)
        elif time.monotonic() - self._held_since > timeout:
            if not self._is_left_alone:
                self._held, self._is_left_alone = self.robot.resting(), True
            sentence = (
                f"No joint_command for {timeout:g} s, so the {self._task.controls.at_rest}: is "
                "policy_executor running and active?"
            )
            self._health.report("command", error=sentence)
        else:
            age = (self.robot.stamp - self._held_stamp) * 1e-9
            self._command_age.held(round(age / self._task.dynamics.time_step))
        self._advance(self._held)

    def _repeat(self) -> None:
        """Sends a state again that has stood for a while: whoever must answer it may be new."""
        if self.robot.stamp == self._seen_stamp:
            if self._lock_step and self.control.running:
                self._health.wait_for(_COMMAND)
                if self._health.is_late(_COMMAND) and self.control.is_stepping:
                    self._health.stop_waiting(_COMMAND)  # but a client waits for its steps
                    self.control.interrupt(
                        f"No joint_command answers the state of {self.robot.stamp * 1e-9:g} s: "
                        "start policy_executor, or start the simulation with mode:=real_time, in "
                        "which it moves without commands."
                    )
            self._publish()
        self._seen_stamp = self.robot.stamp
        self._health.set_value("simulated time", f"{self.robot.stamp * 1e-9:g} s")

    # For the services

    def initial_state(self) -> Array:
        """Returns the state at the beginning, shape (n_x,)."""
        return self._to_state(value(self, self._initial_state))

    def put(self, state: Array | None, *, time: bool) -> None:
        """Puts the robot into a state, where one is given, and its time to 0, where asked."""
        self.robot.reset(state, time=time)
        if state is not None:
            self.control.recover()
        self._health.clear("state", "simulator")
        self.begin()

    def begin(self) -> None:
        """Waits for a new command, and publishes the state that it is to answer."""
        self._held, self._is_left_alone = self.robot.resting(), True  # in real time
        self._held_stamp, self._held_since = 0, float("nan")
        self._health.stop_waiting(_COMMAND)
        self._health.clear("command")
        self._publish()


class _CommandAge:
    """Shows on /diagnostics for how many control steps each command was held; one is right."""

    def __init__(self, health: Health):
        self._health = health
        self._overruns = self._steps = 0
        self._begin()

    def _begin(self) -> None:
        self._since, self._ages, self._oldest, self._count = time.monotonic(), 0, 0, 0

    def held(self, age: int) -> None:
        """Notes a step under a command whose state is so many steps older than the newest one."""
        self._steps += 1
        self._overruns += age > 0
        self._ages += age
        self._count += 1
        self._oldest = max(self._oldest, age)
        if age == _OLDEST_COMMAND:
            sentence = (
                f"A command was held for {age} control steps or more, but each step needs a new "
                "one: give the controller more of the processor, or bring it nearer."
            )
            self._health.report("command age", error=sentence)
        if time.monotonic() - self._since > _FIGURE_PERIOD:
            if self._oldest < _OLDEST_COMMAND:
                self._health.clear("command age")
            mean = self._ages / self._count
            self._health.set_value("command age", f"mean {mean:.2f}, largest {self._oldest} steps")
            self._health.set_value("overruns", f"{self._overruns} of {self._steps}")
            self._begin()


NODE = Runnable(SimulationNode, streaming_executor)
